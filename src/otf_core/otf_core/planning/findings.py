# SPDX-License-Identifier: Apache-2.0
"""What a plan cannot show, from which size on it shows effects, and what would separate them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.aside import share_out
from otf_core.diagnosis.engine.effect_products import ShapeProducts, tried_shapes
from otf_core.diagnosis.engine.residual_rows import Rows, rows_of
from otf_core.diagnosis.engine.search import (
    Visibility,
    best_sight,
    effects_without,
    shapes_of,
    sight_of,
)
from otf_core.effects import REGISTRY, Effect
from otf_core.model.frames import XYZ
from otf_core.model.kinematics import motion_influence
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion, unit_of
from otf_core.planning.forecast import Forecast, Planned
from otf_core.solving.solution import TIE_BREAK, Positive, smoothness
from otf_core.solving.unknowns import Unknowns, reference_position

# What a plan cannot show, in words: which errors are mixed up, why, and what would part them.
#
# A rotation is distinguished from the translations of its axis only by the travel of another axis
# in its lever arm, and not if that travel is parallel to its axis of rotation. Where the chain
# offers none, a second target offset does.

_IMITATED_SHARE = 0.1
"""Part of a motion's effect that another one must imitate to be named."""


@dataclass(frozen=True)
class UnseenError:
    """One error that a plan does not show, or not everywhere.

    Attributes
    ----------
    error : str
        Motion or squareness error; an axis if part of its range is not driven.
    mixed_with : tuple of str
        Errors that take up its effect; empty if it has none that is seen.
    words : str
        What is the matter.
    needs : str
        What would show it.
    """

    error: str
    mixed_with: tuple[str, ...]
    words: str
    needs: str


def offset_in_words(machine: Machine) -> str:
    """State how the target lies: 'with one target offset along Z'."""
    large = np.abs(machine.target_offset) > 1e-9
    if not large.any():
        return 'with the target at the origin of the tool side'
    if large.sum() == 1:
        return f'with one target offset along {XYZ[int(large.argmax())]}'
    return 'with one target offset'


def chain_shows(machine: Machine, error: str) -> bool:
    """Return whether some path with one target offset tells an error from all others."""
    if error in SQUARENESS or unit_of(error) == 'm':
        return True
    motion = ErrorMotion.of(error)
    about, axis = XYZ[motion.along], motion.axis
    return any(a not in (axis, about) for a in machine.chain.lever_axes(axis))


def _bow(unknowns: Unknowns, name: str) -> Array:
    """Values of a motion that neither squareness nor pose can imitate: a bow, in its gauge."""
    block = unknowns.blocks[name]
    if name in SQUARENESS:
        return np.ones(1)
    motion = ErrorMotion.of(name)
    basis = unknowns.bases[motion.axis]
    low, high = basis.knots[0], basis.knots[-1]

    def bow(q: Array) -> Array:
        return np.asarray((q - low) * (high - q) / max(high - low, 1e-12) ** 2)

    value = basis.from_values @ bow(basis.centres)
    if not motion.is_straightness:
        value -= bow(np.array([reference_position(low, high)]))
    free = unknowns.free_blocks[name]
    gauge = unknowns.gauge.toarray()[block, free]
    return np.asarray(np.linalg.lstsq(gauge, value, rcond=None)[0])


def imitators(result: Forecast, errors: Sequence[str], limit: float) -> dict[str, tuple[str, ...]]:
    """Seen errors that take up the effect of unseen ones, the strongest first.

    Parameters
    ----------
    limit : float
        m or rad; ``unidentifiable_above``.
    """
    if not errors:
        return {}
    unknowns, matrix = result.unknowns, result.normal.matrix * limit**2
    blocks = [unknowns.free_blocks[n] for n in result.solution.accepted]
    use = np.concatenate([np.arange(b.start, b.stop) for b in blocks])
    bows = np.zeros((unknowns.free, len(errors)))
    for k, error in enumerate(errors):
        bows[unknowns.free_blocks[error], k] = _bow(unknowns, error)
    pulled = matrix @ bows
    prior = TIE_BREAK * smoothness(unknowns)[np.ix_(use, use)]
    coefficients = np.zeros_like(bows)
    coefficients[use] = Positive(matrix[np.ix_(use, use)] + prior).solve(pulled[use])
    largest = max(float(np.max(np.diag(matrix))), 1.0)
    shares = {}
    for error, bow, pull, own in zip(errors, bows.T, pulled.T, coefficients.T, strict=True):
        size = float(bow @ pull)
        seen = size > 1e-6 * largest * float(bow @ bow)
        shares[error] = _strongest(result, matrix, own, _IMITATED_SHARE * size) if seen else ()
    return shares


def _strongest(
    result: Forecast, matrix: Array, coefficients: Array, least: float
) -> tuple[str, ...]:
    """Errors by their weight with some coefficients (free,), where it is above the least."""
    weights = []
    for name in result.solution.accepted:
        part = result.unknowns.free_blocks[name]
        weight = float(coefficients[part] @ matrix[part, part] @ coefficients[part])
        if name in (*SQUARENESS, *MOTIONS) and weight > least:
            weights.append((weight, name))
    return tuple(name for _, name in sorted(weights, reverse=True))


def _moves_nothing(result: Forecast, machine: Machine, error: ErrorMotion) -> bool:
    influence = motion_influence(machine, error, result.pieces.origin)
    return bool(np.abs(influence).max() < 1e-9)


def _unseen(
    result: Forecast, machine: Machine, error: str, others: tuple[str, ...]
) -> UnseenError:
    motion = ErrorMotion.of(error) if error in MOTIONS else None
    if motion and len(result.nodes[motion.axis]) == 1:
        words = f'{error}: the path does not move {motion.axis}'
        return UnseenError(error, (), words, f'lines that move {motion.axis}')
    if motion and not motion.is_translation and _moves_nothing(result, machine, motion):
        words = f'{error}: a rotation about an axis through the target does not move it'
        return UnseenError(error, (), words, _second_offset(XYZ[motion.along]))
    if motion and not chain_shows(machine, error):
        about = XYZ[motion.along]
        names = ' and '.join(others) or f'the translations of {motion.axis}'
        words = f'{error}: cannot be distinguished from {names} {offset_in_words(machine)}'
        return UnseenError(error, others, words, _second_offset(about))
    if others:
        words = f'{error}: this path confounds it with {" and ".join(others)}'
    else:
        words = f'{error}: it acts only along the lines of this path, or where no line is driven'
    return UnseenError(error, others, words, 'face and space diagonals in several planes')


def _second_offset(about: str) -> str:
    across = ' or '.join(a for a in XYZ if a != about)
    return f'a second run with a target offset that differs in {across}'


def _loose(name: ErrorMotion, positions: Array, nodes: int) -> UnseenError:
    needs = f'face and space diagonals across {name.axis} there'
    fixed = 2 if name.is_straightness else 1
    if len(positions) >= nodes - fixed:
        words = f'{name}: not determined at any node but the reference'
    else:
        where = ', '.join(f'{p:g}' for p in positions)
        words = f'{name}: not determined at {name.axis} = {where} m; interpolated there'
    return UnseenError(name, (), words, needs)


def findings(result: Forecast, machine: Machine, limit: float) -> tuple[UnseenError, ...]:
    """State what a plan does not show.

    Parameters
    ----------
    limit : float
        m or rad; ``unidentifiable_above``.

    Returns
    -------
    tuple of Unseen
        Unseen errors first, then motions that are not determined at single nodes, then parts of
        the axis ranges that are not driven.
    """
    mixed = imitators(result, result.not_identifiable, limit)
    unseen = [_unseen(result, machine, error, others) for error, others in mixed.items()]
    for name, positions in result.loose_nodes.items():
        unseen.append(_loose(name, positions, len(result.nodes[name.axis])))
    unseen += _not_driven(result, machine)
    return tuple(unseen)


def _not_driven(result: Forecast, machine: Machine) -> list[UnseenError]:
    """Ends of the axis ranges beyond the plan: no forecast holds there."""
    gaps = []
    for axis in machine.axis_names:
        nodes, spec = result.nodes[axis], machine.axes[axis]
        gap = max(nodes[0] - spec.min, spec.max - nodes[-1])
        if gap > 1e-6 and len(nodes) > 1:
            words = (
                f'{axis}: driven from {1e3 * nodes[0]:g} mm to {1e3 * nodes[-1]:g} mm; beyond, '
                f'up to {1e3 * gap:.1f} mm, the tables are constant and this forecast does not '
                f'apply'
            )
            gaps.append(UnseenError(axis, (), words, 'a smaller margin'))
    return gaps


# Before measuring: which effects a plan would show, from which size on, and which not apart.

INDISTINGUISHABLE_SHARE = 0.97
"""Share of the squared trace that another effect can leave as well: not told apart."""


def forecast_rows(planned: Planned, limit: float) -> Rows:
    """Rows of the pieces that a recording of a plan would give, with zero deviations."""
    observed, solution, _ = planned
    return rows_of([observed], solution, limit)


@dataclass(frozen=True)
class Trace:
    """What an effect leaves in the rows beyond tables and poses.

    An effect is distinguished from another if it acts in its simplest form, the first of its
    shapes, and the other takes up what it can in its richest, the last.

    Attributes
    ----------
    simple : ndarray, shape (r, k)
        Columns of the first shape with all terms, each of unit size where it acts.
    rich : ndarray, shape (r, m)
        Orthonormal columns that span those of the last shape.
    """

    simple: Array
    rich: Array

    @classmethod
    def of(cls, first: ShapeProducts, last: ShapeProducts) -> Trace:
        """For the first and the last shape of an effect."""
        simple = _columns(first)
        rich = simple if last is first else _columns(last)
        values, vectors = np.linalg.eigh(rich.T @ rich)
        seen = values > 1e-9 * values[-1]
        return cls(simple, rich @ (vectors[:, seen] / np.sqrt(values[seen])))

    def imitated_by(self, other: Trace) -> bool:
        """Return whether another effect can leave every trace of this one."""
        shared = other.rich.T @ self.simple
        return float(np.sum(shared**2)) > INDISTINGUISHABLE_SHARE * self.square

    @cached_property
    def square(self) -> float:
        """Sum of the squared columns of the first shape."""
        return float(np.vdot(self.simple, self.simple))


def not_told_apart(traces: Mapping[str, Trace]) -> dict[str, tuple[str, ...]]:
    """Effects that could be taken for each effect."""

    def others(name: str) -> tuple[str, ...]:
        own = traces[name]
        return tuple(n for n, other in traces.items() if n != name and own.imitated_by(other))

    return dict(zip(traces, share_out(others, list(traces)), strict=True))


def _columns(tried: ShapeProducts) -> Array:
    """What an effect with all terms adds beyond the tables, each of unit size where it acts."""
    option = tried.source.option(tried.takes[0])
    return np.asarray(option.own / option.size)


def _visibility_of(rows: Rows, effect: Effect) -> tuple[Visibility, Trace | None]:
    """How well an effect is seen, and its trace."""
    chosen, stand_in = shapes_of(rows, effect, {})
    tried = tried_shapes(rows, effect, chosen or stand_in)
    sight = best_sight([sight_of(t) for t in tried])
    most = max((t.takes[0].size for t in tried if t.takes), default=0)
    whole = [t for t in tried if t.takes and t.takes[0].size == most]
    if not chosen or not whole:
        return sight, None
    return sight, Trace.of(whole[0], whole[-1])


def forecast_effects(rows: Rows) -> list[dict[str, Any]]:
    """Judge every effect of the catalogue for a plan.

    Parameters
    ----------
    rows : Rows
        See ``forecast_rows``.

    Returns
    -------
    list of mapping
        effect, visible, smallest_um (root mean square displacement that would be found),
        not_told_from, needs, words.
    """
    visible, traces = {}, {}
    rows.factor, rows.residual  # noqa: B018  made once, before threads need them
    effects = effects_without(())
    longest = sorted(effects, key=lambda e: not e.many_alike)  # begun first, and not sent
    judged = dict(
        zip(
            longest,
            share_out(partial(_visibility_of, rows), longest, (rows, *longest)),
            strict=True,
        )
    )
    for effect in effects:
        sight, trace = judged[effect]
        visible[effect.name] = sight
        if sight.visible and trace is not None:
            traces[effect.name] = trace
    apart = not_told_apart(traces)
    entries = []
    for name, sight in visible.items():
        others = apart.get(name, ())
        size = f'{1e6 * sight.smallest:.2f} um'
        words = (
            f'{name:28} found from {size} on'
            if sight.visible
            else (f'{name:28} not visible; needs {REGISTRY[name].needs}')
        )
        if others:
            words += f', indistinguishable from {", ".join(others)}'
        entries.append(
            {
                'effect': name,
                'visible': sight.visible,
                'smallest_um': 1e6 * sight.smallest if np.isfinite(sight.smallest) else None,
                'not_told_from': list(others),
                'needs': REGISTRY[name].needs,
                'words': words,
            }
        )
    return entries

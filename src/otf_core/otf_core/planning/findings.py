# SPDX-License-Identifier: Apache-2.0
"""What a plan cannot show, from which size on it shows effects, and what would separate them.

A sample says nothing along the direction of travel, so an error is seen at an axis position only
if the reflector passes there in directions that leave no common component out. For unknowns x with
rows A(q), driven directions d and P = I - d d^T, x is not seen if and only if

    P A(q) x = 0   at every driven place                                      (rank condition)

A rotation is distinguished from the translations of its axis only by the travel of another axis
in its lever arm, and not if that travel is parallel to its axis of rotation. Where the chain
offers none, a target at another offset does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.aside import share_out
from otf_core.diagnosis.engine.effect_products import ShapeProducts, tried_shapes
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import (
    Visibility,
    best_sight,
    shapes_of,
    sight_of,
)
from otf_core.documents import Document, stated
from otf_core.effects import BelongsTo, Effect, catalogue
from otf_core.errors import ConfigError
from otf_core.model.chain import Sight
from otf_core.model.frames import XYZ
from otf_core.model.machine import BED, TABLE, Machine
from otf_core.model.motions import DIRECTIONS, ErrorMotion, is_motion, unit_of
from otf_core.model.plan import Part, Plan
from otf_core.planning.chains import courses, creeps
from otf_core.planning.forecast import STILL, Forecast
from otf_core.solving.solution import TIE_BREAK, Positive, free_columns, smoothness
from otf_core.solving.unknowns import Unknowns, reference_position

DIAGONALS = {
    1: 'stops at every corner (--method standstill)',
    2: 'diagonals, and lines of half slope',
    3: 'face and space diagonals in several planes',
}
"""What shows more by the number of linear axes."""
IMITATED_SHARE = 0.1
"""Part of a motion's effect that another one must imitate to be named."""


@dataclass(frozen=True)
class UnseenError(Document):
    """One error that a plan does not show, or not everywhere."""

    error: str = stated('motion or scalar error; an axis if part of its range is not driven')
    mixed_with: tuple[str, ...] = stated('errors that take up its effect')
    words: str = stated('what is the matter')
    needs: str = stated('what would show it')


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
    if not is_motion(error) or unit_of(error) == 'm':
        return True
    motion = ErrorMotion.of(error)
    about, axis = XYZ[motion.along], motion.axis
    return any(a not in (axis, about) for a in machine.chain.lever_axes(axis))


def _bow(unknowns: Unknowns, name: str) -> Array:
    """Values of a motion that neither squareness nor pose can imitate: a bow, in its gauge."""
    block = unknowns.blocks[name]
    if not is_motion(name):
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
    unknowns, matrix = result.unknowns, result.nodal.matrix * limit**2
    use = free_columns(unknowns, result.accepted)
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
        shares[error] = _strongest(result, matrix, own, IMITATED_SHARE * size) if seen else ()
    return shares


def _strongest(
    result: Forecast, matrix: Array, coefficients: Array, least: float
) -> tuple[str, ...]:
    """Errors by their weight with some coefficients (free,), where it is above the least."""
    weights = []
    for name in map(str, result.determined):
        part = result.unknowns.free_blocks[name]
        weight = float(coefficients[part] @ matrix[part, part] @ coefficients[part])
        if name in result.accepted and weight > least:
            weights.append((weight, name))
    return tuple(name for _, name in sorted(weights, reverse=True))


def findings(plan: Plan, result: Forecast, limit: float) -> tuple[UnseenError, ...]:
    """State what a plan does not show.

    Parameters
    ----------
    limit : float
        m or rad; ``unidentifiable_above``.

    Returns
    -------
    tuple of UnseenError
        Unseen errors first, then motions that are not determined at single nodes, then parts of
        the axis ranges that are not driven.
    """
    machine = result.joint.machine
    mixed = imitators(result, result.not_identifiable, limit)
    unseen = [
        UnseenError(error, others, *_why(machine, plan.parts, error, others))
        for error, others in mixed.items()
    ]
    for name, positions in result.loose_nodes.items():
        unseen.append(_loose(machine, name, positions, len(result.nodes[name[-1]])))
    return tuple(unseen + _not_driven(result, machine))


def _why(
    machine: Machine, parts: Sequence[Part], error: str, others: tuple[str, ...]
) -> tuple[str, str]:
    """State why an error is not seen, and what would show it."""
    axis, rotation = error[-1], is_motion(error) and error[1] in 'ABC'
    turns = axis in machine.rotary_names
    on_table = {n for n, t in machine.targets.items() if t.link == TABLE}
    bed = machine.tracker.link == BED
    moved = [p for p in parts if axis in _in_view(machine, p) and _travels(machine, p, axis)]
    if not moved:
        words = f'{error}: no part moves {axis} between tracker and reflector'
        if bed and axis in machine.chain.table_side and not on_table:
            return words, 'three targets on the table (link: w) in machine.yaml'
        return words, f'a part that moves {axis}'
    if rotation and _lever(machine, moved, error) < STILL:
        words = f'{error}: a rotation about a line through the reflectors does not move them'
        return words, _other_offset(error[1])
    angular = error[1] == axis or error in machine.location
    if turns and angular and not any(_combined(machine, p, axis) or p.stops for p in moved):
        return (
            f'{error}: every leg that turns {axis} moves nothing else, and the direction of '
            f'travel, which is left out, is the one in which it acts',
            'another axis driven at the same time, in both senses, or stops',
        )
    table = {p.target for p in moved} & on_table
    if turns and bed and 0 < len(table) < 3:
        words = f'{error}: seen with {len(table)} reflector place(s) on the table'
        return words, f'three places, not in line with {axis}'
    if turns and not table:
        try:
            creeps(machine, {axis: courses(machine, axis)}, moved[0].target)
        except ConfigError as problem:
            return f'{error}: the linear axes do not follow the rotation: {problem}', 'more travel'
    if rotation and not chain_shows(machine, error) and len({p.target for p in moved}) == 1:
        names = ' and '.join(others) or f'the translations of {axis}'
        words = f'{error}: cannot be distinguished from {names} {offset_in_words(machine)}'
        return words, _other_offset(error[1])
    if turns or len(machine.axis_names) > len(XYZ):
        words = f'{error}: the reflectors and moves of {axis} say too little of it'
        return words, 'a target of other length or farther off the axis, longer travel, or time'
    needs = DIAGONALS[len(machine.axis_names)]
    if others:
        return f'{error}: this path confounds it with {" and ".join(others)}', needs
    return (
        f'{error}: it acts only along the lines of this path, or where no line is driven',
        needs,
    )


def _other_offset(about: str) -> str:
    across = ' or '.join(a for a in XYZ if a != XYZ['ABC'.index(about)])
    return f'a second run or target with a target offset that differs in {across}'


def _in_view(machine: Machine, part: Part) -> set[str]:
    """Axes between the tracker and the reflector of a part."""
    return {j.name for j in Sight.of_target(machine, part.target).joints}


def _travels(machine: Machine, part: Part, axis: str) -> bool:
    return bool(np.ptp(part.path.positions[:, machine.column(axis)]) > 0.0)


def _lever(machine: Machine, parts: Sequence[Part], name: str) -> float:
    """Most that a reflector moves per unit of a motion, m/rad."""
    most = 0.0
    for part in parts:
        seen = Sight.of_target(machine, part.target).at(part.path.positions)
        six = seen.motions[name[-1]][:, :, DIRECTIONS.index(name[1])]
        most = max(most, float(np.abs(six).max()))
    return most


def _combined(machine: Machine, part: Part, axis: str) -> bool:
    """Return whether a part turns an axis while another one in view moves."""
    steps = np.abs(np.diff(part.path.positions, axis=0)) > 0.0
    others = [machine.column(a) for a in _in_view(machine, part) if a != axis]
    return bool(np.any(steps[:, machine.column(axis)] & steps[:, others].any(axis=1)))


def _loose(machine: Machine, name: str, positions: Array, nodes: int) -> UnseenError:
    axis, unit = name[-1], machine.axes[name[-1]].unit
    needs = f'face and space diagonals across {axis} there'
    if machine.axes[axis].rotary:
        needs = f'more moves of {axis} there, together with another axis'
    if len(positions) >= nodes - (2 if ErrorMotion.of(name).is_straightness else 1):
        words = f'{name}: not determined at any node but the reference'
        return UnseenError(name, (), words, needs)
    where = ', '.join(f'{p:.4g}' for p in positions)
    words = f'{name}: not determined at {axis} = {where} {unit}; interpolated there'
    return UnseenError(name, (), words, needs)


def _not_driven(result: Forecast, machine: Machine) -> list[UnseenError]:
    """Ends of the axis ranges beyond the plan: no forecast holds there."""
    gaps = []
    for axis, spec in machine.axes.items():
        nodes = result.nodes[axis]
        gap = max(nodes[0] - spec.min, spec.max - nodes[-1])
        if gap > (2e-5 if spec.rotary else 1e-6) and len(nodes) > 1:
            scale, unit = (np.degrees(1.0), 'degrees') if spec.rotary else (1e3, 'mm')
            words = (
                f'{axis}: driven from {scale * nodes[0]:g} to {scale * nodes[-1]:g} {unit}; '
                f'beyond, up to {scale * gap:.1f} {unit}, the tables are constant and this '
                f'forecast does not apply'
            )
            gaps.append(UnseenError(axis, (), words, 'a smaller margin'))
    return gaps


# Before measuring: which effects a plan would show, from which size on, and which not apart.

INDISTINGUISHABLE_SHARE = 0.97
"""Share of the squared trace that another effect can leave as well: not told apart."""


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
        Of the pieces that a recording of the plan would give.

    Returns
    -------
    list of mapping
        effect, visible, smallest_um (root mean square displacement that would be found),
        not_told_from, needs, words.
    """
    visible, traces = {}, {}
    rows.factor, rows.residual  # noqa: B018  made once, before threads need them
    known = catalogue(rows.states[0].machine)
    effects = [e for e in known.values() if e.belongs_to is not BelongsTo.NOISE]
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
            else (f'{name:28} not visible; needs {known[name].words.shown_by}')
        )
        if others:
            words += f', indistinguishable from {", ".join(others)}'
        entries.append(
            {
                'effect': name,
                'visible': sight.visible,
                'smallest_um': 1e6 * sight.smallest if np.isfinite(sight.smallest) else None,
                'not_told_from': list(others),
                'needs': known[name].words.shown_by,
                'words': words,
            }
        )
    return entries

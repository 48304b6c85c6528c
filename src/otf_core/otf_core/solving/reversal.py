# SPDX-License-Identifier: Apache-2.0
"""Reversal of the error motions: how they differ between forward and backward travel.

Unknowns are the coefficients of the effects ``backlash`` (constants of EXX, EYY, EZZ) and
``direction_dependent_tables`` (all others), with their formulas:

    delta = 1/2 sign(d_a) sum_k c_k P_k(u_a) J_m(q)      motion m of axis a

The reversal value of a motion is its error in forward travel less that in backward travel
(ISO 230-2: difference of the means of the two directions of approach); tables hold the mean.

An axis that is late by T behind the others displaces the target by -v T along its travel: where
axes drive at one feed it looks like backlash. Both are blocks of one selection on held-out lines
(``selection``). An axis that stands after its travel shows backlash, but no lag.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.effects.catalogue.machine import ORDER, functions_along
from otf_core.model.chain import Sight
from otf_core.model.expanded import quantity
from otf_core.model.machine import Axis, Machine
from otf_core.model.motions import DIRECTIONS, ErrorMotion
from otf_core.model.path import MOVING
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Observed
from otf_core.solving.joint import JointSolution, unknowns_of
from otf_core.solving.residuals import FOLDS
from otf_core.solving.selection import (
    MIN_GAIN_OVER_SCATTER,
    Block,
    HeldOutLines,
    Selection,
    select,
)
from otf_core.solving.unknowns import (
    Unknowns,
    is_reversal,
    lag_block,
    reversal_blocks,
    reversal_names,
    reversal_order,
)

NONE, CONSTANT, TABLES, AUTO = 'none', 'constant', 'tables', 'auto'
MODELS = {NONE: 0, CONSTANT: 1, TABLES: ORDER + 1}
"""Polynomials per motion in every model, the simplest first."""


def count_functions(axis: Axis, model: str) -> int:
    """Functions per motion of an axis; one more where it turns: worms and gears make waves."""
    return MODELS[model] + (model == TABLES and axis.rotary)


MOST = 1e-3
"""m and rad, and s; standard deviation of the prior of reversal and lags: they are smaller."""
MIN_LINES = 16
"""Fewer lines do not determine the scatter of a gain: nothing is added then."""


@dataclass(frozen=True)
class Choice:
    """What differs between both senses of travel.

    Attributes
    ----------
    model : str
        A name of ``MODELS``.
    held : bool
        Axes that stand stay on the side of their last travel.
    evidence : mapping of str to number or text
        'decided_by'; of held-out lines their number, 'folds', 'gain' of all that was chosen over
        nothing, or of the best block that was not, its 'scatter', how many times this is 'needed',
        and what would explain the lines as well.
    """

    model: str
    held: bool
    evidence: Mapping[str, float | int | str]


def choose_reversal(
    runs: Sequence[Observed], joint: JointSolution, config: CalibrationConfig
) -> tuple[Choice, Unknowns]:
    """Choose which motions reverse, as constants or tables, and which axes are late.

    The reversal model may be given by the configuration; whether axes at rest are held is always
    chosen.

    Parameters
    ----------
    joint : JointSolution
        Of the same runs, without reversal.

    Returns
    -------
    choice : Choice
    unknowns : Unknowns
        With the reversal coefficients and lags to solve for.
    """
    machine, bases, given = joint.machine, joint.unknowns.bases, config.reversal
    lines = sum(int(own.max()) + 1 for own in (s.whitener.line for s in joint.runs))
    by_configuration: dict[str, float | int | str] = {'decided_by': 'configuration'}
    if given == NONE:
        return Choice(NONE, False, by_configuration), joint.unknowns
    if lines < MIN_LINES and given == AUTO:
        few = f'too few lines: {lines}, {MIN_LINES} needed'
        return Choice(NONE, False, {'decided_by': few, 'lines': lines}), joint.unknowns
    seen = [m for m in machine.motions if m in joint.solution.accepted]
    late = [lag_block(a) for a in machine.axis_names]
    every = _reversal(machine, seen, CONSTANT if given == CONSTANT else TABLES)
    tried: list[tuple[float, Unknowns, Selection]] = []
    rests = any(np.any((r.pieces.side != 0.0) & (np.abs(r.pieces.step) <= MOVING)) for r in runs)
    for held in (False, True) if rests else (False,):
        unknowns = unknowns_of(runs, bases, every, machine.axis_names, held=held)
        held_out = HeldOutLines.of(joint, unknowns, np.full(len(every) + len(late), MOST))
        found = Selection(tuple(every), 0.0, 0.0)
        if given == AUTO:
            found = select(held_out, _candidates(machine, seen))
        reverses = [n for n in found.names if is_reversal(n)]
        axes = [a for a in machine.axis_names if lag_block(a) in found.names]
        chosen = unknowns_of(runs, bases, reverses, axes, held=held)
        tried.append((float(held_out.estimate(found.names)[1].sum()), chosen, found))
        if not reverses:
            break  # no reversal at all, so none that is held
    # of equals the first counts
    _, unknowns, found = min(tried, key=lambda one: one[0])
    if given != AUTO:
        return Choice(given, unknowns.held, by_configuration), unknowns
    orders = [reversal_order(n) for n in found.names if is_reversal(n)]
    model = NONE if not orders else TABLES if max(orders) else CONSTANT
    evidence: dict[str, float | int | str] = {
        'decided_by': 'held-out lines',
        'lines': lines,
        'folds': FOLDS,
        'needed': MIN_GAIN_OVER_SCATTER,
        'gain': found.gain,
        'scatter': found.scatter,
    }
    if found.indistinguishable_from:
        evidence['indistinguishable_from'] = ', '.join(found.indistinguishable_from)
    return Choice(model, unknowns.held, evidence), unknowns


def _reversal(machine: Machine, motions: Sequence[ErrorMotion], model: str) -> list[str]:
    """Blocks of the reversal coefficients of motions, order by order, translations first."""
    count: dict[str, int] = {m: count_functions(machine.axes[m.axis], model) for m in motions}
    names = reversal_names(motions, max(count.values(), default=0))
    return [name for name in names if reversal_order(name) < count[name[:3]]]


def _candidates(machine: Machine, seen: Sequence[ErrorMotion]) -> list[Block]:
    """Reversal of motions, of an axis, of all drives and of the machine, and lags likewise."""
    groups = [[m] for m in seen]
    groups += [[m for m in seen if m.axis == a] for a in machine.axis_names]
    groups += [[m for m in seen if m.is_positioning], list(seen)]
    blocks = [
        Block(tuple(_reversal(machine, group, model)))
        for model in (CONSTANT, TABLES)
        for group in groups
        if group
    ]
    late = [lag_block(axis) for axis in machine.axis_names]
    return [*blocks, *(Block((name,), positive=True) for name in late), Block(tuple(late))]


@dataclass(frozen=True)
class AxisLag:
    """Time by which an axis is late behind the others, s, and its standard uncertainties.

    ``u_run`` is that by noise and misfit of the run alone.
    """

    axis: str
    value: float
    u: float
    u_run: float | None = None


def lags(joint: JointSolution, covariance: Array) -> list[AxisLag]:
    """Lags of a solution, by a covariance (full, full) of its unknowns."""
    found = []
    for axis in joint.machine.axis_names:
        block = joint.unknowns.blocks.get(lag_block(axis))
        if block is not None and lag_block(axis) in joint.solution.accepted:
            u = float(np.sqrt(max(covariance[block.start, block.start], 0.0)))
            found.append(AxisLag(axis, float(joint.solution.value[block.start]), u))
    return found


@dataclass(frozen=True)
class ReversalTable:
    """Reversal value of one motion along its axis.

    Attributes
    ----------
    position : ndarray, shape (k,), m
        Nodes of the table of the motion.
    value, u : ndarray, shape (k,), m or rad
        Forward minus backward, and its standard uncertainty (k = 1).
    identifiable : bool
        False if the data cannot see it; its values are zero then.
    u_run : ndarray, shape (k,), optional
        Standard uncertainty by noise and misfit of the run alone.
    """

    position: Array
    value: Array
    u: Array
    identifiable: bool
    u_run: Array | None = None


@dataclass(frozen=True)
class Backlash:
    """Reversal value of an axis at the target: along it, all its motions that reverse together.

    Attributes
    ----------
    value, u : float, m
        Forward minus backward, mean along the middle line of the axis; standard uncertainty.
    u_run : float, m, optional
        The same by noise and misfit of the run alone.
    """

    value: float
    u: float
    u_run: float | None = None

    @property
    def words(self) -> str:
        """Value and expanded uncertainty (k = 2)."""
        return quantity(self.value, self.u, 'm')


@dataclass(frozen=True)
class Reversal:
    """Reversal model of a calibration.

    Attributes
    ----------
    model : str
        A name of ``MODELS``.
    evidence : mapping of str to number or text
        Why this model, see ``Choice``.
    motions : mapping of motion name to ReversalTable
        Empty for the model 'none'.
    held : bool
        Axes that stand stay on the side of their last travel.
    backlash : mapping of axis to Backlash
        Of the axes whose positioning the data see; empty for the model 'none'.
    """

    model: str
    evidence: Mapping[str, float | int | str]
    motions: Mapping[str, ReversalTable]
    held: bool = False
    backlash: Mapping[str, Backlash] = field(default_factory=dict)

    @property
    def not_identifiable(self) -> tuple[str, ...]:
        """Motions whose reversal the data cannot see."""
        return tuple(n for n, table in self.motions.items() if not table.identifiable)


def reversal_tables(
    tables: ErrorTables,
    unknowns: Unknowns,
    estimate: Array,
    covariance: Array,
    accepted: Collection[str],
) -> dict[str, ReversalTable]:
    """Reversal values at the table nodes.

    Parameters
    ----------
    tables : ErrorTables
        With the nodes.
    estimate, covariance : ndarray, shape (full,) and (full, full), m and rad
    accepted : collection of str
        Blocks that were solved for.

    Returns
    -------
    mapping of motion to ReversalTable
        Of the motions whose reversal is among the unknowns.
    """
    tables_by_motion: dict[str, ReversalTable] = {}
    for motion in tables.machine.motions:
        names = reversal_blocks(unknowns, motion)
        if not names:
            continue
        nodes = tables.motions[motion].position
        index = [unknowns.blocks[n].start for n in names]
        along = functions_along(tables.machine.axes[motion.axis], nodes, len(names) - 1)
        variance = np.einsum('ij,jk,ik->i', along, covariance[np.ix_(index, index)], along)
        tables_by_motion[motion] = ReversalTable(
            nodes,
            along @ estimate[index] + 0.0,
            np.sqrt(np.maximum(variance, 0.0)),
            any(n in accepted for n in names),
        )
    return tables_by_motion


def backlash_at_target(
    tables: ErrorTables,
    unknowns: Unknowns,
    estimate: Array,
    covariance: Array,
    accepted: Collection[str],
) -> dict[str, Backlash]:
    """Reversal value of every axis at the target, on its line through the middle of the volume.

    A rotation that reverses displaces the target as positioning does, and the two are hardly told
    apart, so that their sum is known far better than the positioning at the reference point.

    Parameters
    ----------
    tables, unknowns, estimate, covariance, accepted
        See ``reversal_tables``.
    """
    machine, backlash = tables.machine, {}
    middle = 0.5 * (machine.lower + machine.upper)
    for column, name in enumerate(machine.axis_names):
        positioning = reversal_blocks(unknowns, f'E{name}{name}')
        if machine.axes[name].rotary or not positioning or positioning[0] not in accepted:
            continue
        nodes = tables.motions[f'E{name}{name}'].position
        q = np.tile(middle, (len(nodes), 1))
        q[:, column] = nodes
        seen = Sight.of_tool(machine).at(q)
        moved = np.einsum('ni,nik->nk', seen.velocity[:, :, column], seen.motions[name])
        row = np.zeros(len(estimate))
        for d, letter in enumerate(DIRECTIONS):
            blocks = reversal_blocks(unknowns, f'E{letter}{name}')
            along = functions_along(machine.axes[name], nodes, max(len(blocks) - 1, 0))
            for block, weight in zip(blocks, along.T, strict=False):
                if block in accepted:
                    row[unknowns.blocks[block].start] += float(np.mean(moved[:, d] * weight))
        u = float(np.sqrt(max(0.0, float(row @ covariance @ row))))
        backlash[name] = Backlash(float(row @ estimate), u)
    return backlash

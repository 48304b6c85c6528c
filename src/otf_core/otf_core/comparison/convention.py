# SPDX-License-Identifier: Apache-2.0
"""Error tables of two sources brought to one convention (paper 2.3.1), covariance included.

Positioning and rotations are zero at the axis' zero position, else at the minimum both know;
straightness is zero at both ends of the common range; what these choices take out of the motions
is squareness, or a rigid motion of no meaning. A rotation that one source cannot see,
because it acts on the target over a lever that no axis changes which moved there, is a translation
for it, at its own target offset and place; it is counted as that one in both. All of it is linear:
value = H nodes, covariance = H C H'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.kinematics import has_constant_lever, motion_influence
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion, unit_of
from otf_core.model.nodes import hat_matrix
from otf_core.model.tables import ErrorTables
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.uncertainty import prediction_rows

SAME_LEVER = 1e-5
"""m; levers that differ by less are one: 1 nm for 100 urad."""


@dataclass(frozen=True)
class Source:
    """Error tables and where they come from.

    Attributes
    ----------
    name : str
    tables : ErrorTables
    whole : ndarray, shape (3 + m, 3 + m)
        Covariance of the squareness errors and the nodes of EXX ... ECZ in that order.
    squareness : tuple of str
        Squareness errors that the source knows.
    """

    name: str
    tables: ErrorTables
    whole: Array
    squareness: tuple[str, ...]

    @property
    def covariance(self) -> Array:
        """Covariance of the nodes, shape (m, m)."""
        return self.whole[len(SQUARENESS) :, len(SQUARENESS) :]

    @property
    def all_values(self) -> Array:
        """Values in the order of ``whole``, shape (3 + m,)."""
        own = [self.tables.squareness[n].value for n in SQUARENESS]
        return np.concatenate([own, self.values])

    @property
    def starts(self) -> dict[str, int]:
        """Place of the first node of each motion in the covariance."""
        sizes = [len(self.tables.motions[m].position) for m in MOTIONS]
        return dict(zip(MOTIONS, np.concatenate([[0], np.cumsum(sizes)]).tolist(), strict=False))

    @property
    def values(self) -> Array:
        """Node values of all motions, shape (m,)."""
        return np.concatenate([self.tables.motions[m].value for m in MOTIONS])


@dataclass(frozen=True)
class Lever:
    """Where a rotation acts as a translation: target offset of a machine, place of its axes, m."""

    machine: Machine
    place: Array

    def influence(self, motion: ErrorMotion, position: Array) -> Array:
        """Displacement per rad at positions (k,), m, of the axis that turns, shape (k, 3)."""
        q = np.tile(self.place, (len(position), 1))
        q[:, motion.place] = position
        return motion_influence(self.machine, motion, q)


@dataclass(frozen=True)
class Common:
    """What two sources share.

    Attributes
    ----------
    machine : Machine
        That of the first, with its target offset.
    position : mapping of axis to ndarray, m
        Positions at which motions are compared.
    folded : mapping of rotation to Lever
        Rotations counted as translations, as the source that cannot see them has them.
    apart : tuple of ErrorMotion
        Those of them that several sources cannot see, over other levers: the translations of
        these sources differ by what no source knows.
    motions : tuple of str
        Motions both know, folded ones left out.
    """

    machine: Machine
    position: Mapping[str, Array]
    folded: Mapping[ErrorMotion, Lever]
    apart: tuple[ErrorMotion, ...]
    motions: tuple[ErrorMotion, ...]


def _known(source: Source, motion: str) -> bool:
    return source.tables.motions[motion].identifiable


def _positions(sources: Sequence[Source], axis: str) -> Array:
    """Nodes of all sources within the range that all cover."""
    nodes = [
        s.tables.motions[m].position for s in sources for m in MOTIONS
        if m.axis == axis and _known(s, m)
    ]  # fmt: skip
    if not nodes:
        return np.zeros(0)
    low, high = max(n[0] for n in nodes), min(n[-1] for n in nodes)
    if high - low < 1e-6:
        raise ConfigError(f'axis {axis}: the sources cover no common range')
    inside = np.concatenate([[low, high], *[n[(n > low) & (n < high)] for n in nodes]])
    places = np.unique(inside)
    return np.asarray(places[np.concatenate([[True], np.diff(places) > 1e-6])])


def _span(motion: ErrorMotion, levers: Sequence[Lever]) -> float:
    """Largest difference of the levers of a rotation that matters, m."""
    acting = [lever.influence(motion, np.zeros(1))[0] for lever in levers]
    return float(np.ptp(acting, axis=0).max())


def common_ground(sources: Sequence[Source]) -> Common:
    """Find what two sources share.

    Raises
    ------
    ConfigError
        If they describe different machines or share nothing.
    """
    machine = sources[0].tables.machine
    for source in sources[1:]:
        if str(source.tables.machine.chain) != str(machine.chain):
            raise ConfigError(
                f'{source.name}: chain {source.tables.machine.chain}, but {sources[0].name} has '
                f'{machine.chain}; not one machine'
            )
    rotations = [m for m in MOTIONS if unit_of(m) == 'rad']
    levers: dict[ErrorMotion, list[Lever]] = {}
    for source in sources:
        own, (low, high) = source.tables.machine, table_ranges(source.tables)
        for m in rotations:
            if not _known(source, m) and has_constant_lever(own, m, low, high):
                levers.setdefault(m, []).append(Lever(own, low))
    folded = {m: own[-1] for m, own in levers.items()}
    apart = tuple(m for m, own in levers.items() if _span(m, own) > SAME_LEVER)
    motions = tuple(m for m in MOTIONS if all(_known(s, m) for s in sources))
    if not motions:
        raise ConfigError('the sources have no error motion in common')
    return Common(
        machine, {a: _positions(sources, a) for a in machine.axis_names}, folded, apart, motions
    )


def _zeroed(motion: ErrorMotion, position: Array, rows: Array) -> Array:
    """Rows with the convention applied: zero at the reference, or at both ends."""
    if motion.is_straightness:
        share = ((position - position[0]) / (position[-1] - position[0]))[:, None]
        return np.asarray(rows - (1.0 - share) * rows[0] - share * rows[-1])
    reference = np.zeros(1) if position[0] <= 0.0 <= position[-1] else position[:1]
    return np.asarray(rows - hat_matrix(position, reference) @ rows)


def operator(source: Source, common: Common) -> Array:
    """Matrix from the nodes of a source to the common motions at the common positions."""
    starts, width = source.starts, source.covariance.shape[0]
    blocks = []
    for motion in common.motions:
        axis = motion.axis
        position = common.position[axis]
        rows = np.zeros((len(position), width))

        def add(name: str, factor: Array, rows: Array = rows, position: Array = position) -> None:
            nodes = source.tables.motions[name].position
            place = slice(starts[name], starts[name] + len(nodes))
            rows[:, place] += factor[:, None] * hat_matrix(nodes, position)

        add(motion, np.ones(len(position)))
        if unit_of(motion) == 'm':
            for name, lever in common.folded.items():
                if name.axis == axis and _known(source, name):
                    add(name, lever.influence(name, position)[:, motion.along])
        blocks.append(_zeroed(motion, position, rows))
    return np.concatenate(blocks)


def vector_rows(common: Common, q: Array) -> Array:
    """From common motions at their positions, and squareness errors, to errors at positions.

    Parameters
    ----------
    common : Common
    q : ndarray, shape (n, 3), m

    Returns
    -------
    ndarray, shape (n, 3, m + 3)
        Derivatives by the m values of all motions, then by C0Y, B0Z, A0Z.
    """
    nodes = {m: common.position[m.axis] for m in common.motions}
    padded: dict[str, Array] = {m: nodes.get(m, np.zeros(1)) for m in MOTIONS}
    rows = prediction_rows(common.machine, padded, q)
    keep: list[int] = []
    start = len(SQUARENESS)
    for motion in MOTIONS:
        if motion in nodes:
            keep += range(start, start + len(padded[motion]))
        start += len(padded[motion])
    keep += range(len(SQUARENESS))
    return np.asarray(rows[:, :, np.array(keep)])


def squareness_rows(source: Source, common: Common, q: Array) -> Array:
    """Squareness errors of a source in the gauge of the common motions.

    What the convention takes out of the common motions is linear in the positions: slopes of
    straightness, constants of rotations over their levers. Together with the squareness errors
    that a source states it is a shear and a rigid motion; the shear is the squareness.

    Parameters
    ----------
    source : Source
    common : Common
    q : ndarray, shape (n, 3), m
        Points that span the common range.

    Returns
    -------
    ndarray, shape (3, 3 + m)
        From the values in the order of ``Source.whole`` to C0Y, B0Z, A0Z.
    """
    first = len(SQUARENESS)
    nodes: dict[str, Array] = {m: source.tables.motions[m].position for m in MOTIONS}
    rows = prediction_rows(common.machine, nodes, q)
    shear = rows[:, :, :first].copy()
    for motion, start in source.starts.items():
        if motion not in common.motions and motion not in common.folded:
            rows[:, :, first + start : first + start + len(nodes[motion])] = 0.0
    rows[:, :, first:] -= vector_rows(common, q)[:, :, :-first] @ operator(source, common)
    x, y, z = (q - q.mean(axis=0)).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    rigid = np.stack(
        [[one, zero, zero, zero, z, -y], [zero, one, zero, -z, zero, x],
         [zero, zero, one, y, -x, zero]]
    ).transpose(2, 0, 1)  # fmt: skip
    basis = np.concatenate([shear, rigid], axis=2).reshape(-1, first + 6)
    return np.asarray((np.linalg.pinv(basis) @ rows.reshape(len(basis), -1))[:first])

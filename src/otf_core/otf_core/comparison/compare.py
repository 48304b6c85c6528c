# SPDX-License-Identifier: Apache-2.0
"""Error tables of two sources in one convention, compared motion by motion and over the volume."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.direct_csv import read_direct_csv
from otf_core.errors import ConfigError
from otf_core.model.direct_measurement import (
    DirectMeasurement,
    motion_readings,
    tables_of_readings,
)
from otf_core.model.evaluation import mean_length, without_rigid_motion
from otf_core.model.kinematics import displacement, has_constant_lever, motion_influence
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion, unit_of
from otf_core.model.nodes import hat_matrix
from otf_core.model.tables import ErrorTables, load_tables
from otf_core.prediction.covariance import unpack_covariance
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.uncertainty import prediction_rows

# Error tables of two sources brought to one convention (paper 2.3.1), covariance included.
#
# Positioning and rotations are zero at the axis' zero position, else at the minimum both know;
# straightness is zero at both ends of the common range; what these choices take out of the motions
# is squareness, or a rigid motion of no meaning. A rotation that one source cannot see, because it
# acts on the target over a lever that no axis changes which moved there, is a translation for it,
# at its own target offset and place; it is counted as that one in both. All of it is linear: value
# = H nodes, covariance = H C H'.

SAME_LEVER = 1e-5
"""m; levers that differ by less are one: 1 nm for 100 urad."""


@dataclass(frozen=True)
class Source:
    """Error tables and where they come from.

    Attributes
    ----------
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


def _is_identifiable(source: Source, motion: str) -> bool:
    return source.tables.motions[motion].identifiable


def _positions(sources: Sequence[Source], axis: str) -> Array:
    """Nodes of all sources within the range that all cover."""
    nodes = [
        s.tables.motions[m].position for s in sources for m in MOTIONS
        if m.axis == axis and _is_identifiable(s, m)
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
                f'{machine.chain}; these are different machines'
            )
    rotations = [m for m in MOTIONS if unit_of(m) == 'rad']
    levers: dict[ErrorMotion, list[Lever]] = {}
    for source in sources:
        own, (low, high) = source.tables.machine, table_ranges(source.tables)
        for m in rotations:
            if not _is_identifiable(source, m) and has_constant_lever(own, m, low, high):
                levers.setdefault(m, []).append(Lever(own, low))
    folded = {m: own[-1] for m, own in levers.items()}
    apart = tuple(m for m, own in levers.items() if _span(m, own) > SAME_LEVER)
    motions = tuple(m for m in MOTIONS if all(_is_identifiable(s, m) for s in sources))
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
                if name.axis == axis and _is_identifiable(source, name):
                    add(name, lever.influence(name, position)[:, motion.along])
        blocks.append(_zeroed(motion, position, rows))
    return np.concatenate(blocks)


def vector_rows(common: Common, q: Array) -> Array:
    """From common motions at their positions, and squareness errors, to errors at positions.

    Parameters
    ----------
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


# Comparison of error tables motion by motion and over the volume (paper 2.3.1 and 2.3.2).
#
# The normalised error E_n = |a - b| / sqrt(U_a^2 + U_b^2), with U = 2 u (ISO 13528), is below 1
# where two sources agree within their stated uncertainties.

COVERAGE_FACTOR = 2.0
"""k of the expanded uncertainties."""
GRID_POINTS = 7
"""points per axis."""


@dataclass(frozen=True)
class MotionComparison:
    """One error motion of two sources in one convention.

    Attributes
    ----------
    position : ndarray, shape (k,), m
    a, b, u_a, u_b : ndarray, shape (k,), m or rad
        Values and standard uncertainties.
    """

    position: Array
    a: Array
    b: Array
    u_a: Array
    u_b: Array

    @property
    def difference(self) -> Array:
        """Value of b less that of a, shape (k,)."""
        return self.b - self.a

    @property
    def normalised(self) -> Array:
        """E_n, shape (k,); nan where the convention fixes both values."""
        return normalised_error(self.difference, np.hypot(self.u_a, self.u_b))


@dataclass(frozen=True)
class SquarenessComparison:
    """A squareness error of two sources in the gauge of the common motions, rad; u: k = 1."""

    a: float
    b: float
    u_a: float
    u_b: float

    @property
    def difference(self) -> float:
        """Value of b less that of a."""
        return self.b - self.a

    @property
    def normalised(self) -> float:
        """E_n; nan where no uncertainty is known."""
        u = np.array([np.hypot(self.u_a, self.u_b)])
        return float(normalised_error(np.array([self.difference]), u)[0])


@dataclass(frozen=True)
class VolumeComparison:
    """Error vectors of two sources on points.

    Attributes
    ----------
    q : ndarray, shape (n, 3), m
    a, b : ndarray, shape (n, 3), m
        Motions in one convention, squareness left out as in the paper.
    u : ndarray, shape (n, 3), m
        Standard uncertainty of the difference.
    squareness : tuple of float, or None
        Mean lengths of a, b and b - a with everything the sources know, squareness included and
        the rigid motion removed, both at the target offset of a; None if one of them lacks
        squareness.
    """

    q: Array
    a: Array
    b: Array
    u: Array
    squareness: tuple[float, float, float] | None

    @property
    def difference(self) -> Array:
        """Vectors of b less those of a, shape (n, 3), m."""
        return self.b - self.a

    @property
    def normalised(self) -> Array:
        """E_n of every component, shape (n, 3)."""
        return normalised_error(self.difference, self.u)


@dataclass(frozen=True)
class Comparison:
    """Two sources compared.

    Attributes
    ----------
    offsets : tuple of ndarray, shape (3,), m
        Target offsets.
    motions : mapping of motion to MotionComparison
    squareness : mapping of name to SquarenessComparison
        Those that both know.
    """

    names: tuple[str, str]
    offsets: tuple[Array, Array]
    common: Common
    motions: Mapping[str, MotionComparison]
    squareness: Mapping[str, SquarenessComparison]
    volume: VolumeComparison

    @property
    def without_u(self) -> tuple[str, ...]:
        """Which of 'a' and 'b' state no uncertainty of any motion: they count as exact in E_n."""
        sides = {
            'a': [m.u_a for m in self.motions.values()],
            'b': [m.u_b for m in self.motions.values()],
        }
        return tuple(side for side, u in sides.items() if not np.concatenate(u).any())


def normalised_error(difference: Array, u: Array) -> Array:
    """E_n for a difference and its standard uncertainty; nan where both are zero."""
    limit = COVERAGE_FACTOR * u
    known = limit > 1e-12 * max(float(np.abs(difference).max(initial=0.0)), 1e-12)
    return np.asarray(np.where(known, np.abs(difference) / np.where(known, limit, 1.0), np.nan))


def source_of_tables(
    name: str, tables: ErrorTables, covariance: Array | None, hidden: Collection[str] = ()
) -> Source:
    """Source of error tables.

    Parameters
    ----------
    covariance : ndarray, shape (3 + m, 3 + m), optional
        Of squareness errors and nodes; independent values if not given.
    hidden : collection of str
        Squareness errors that are not known.
    """
    known = tuple(n for n in SQUARENESS if n not in hidden)
    if covariance is None:
        square = [tables.squareness[n].u for n in SQUARENESS]
        u = np.concatenate([square, *(tables.motions[m].u for m in MOTIONS)])
        covariance = np.diag(u**2)
    return Source(name, tables, covariance, known)


def source_of_measurement(name: str, measurement: DirectMeasurement, machine: Machine) -> Source:
    """Source of a direct measurement: means over runs and directions, u from their scatter."""
    motions = motion_readings(measurement, machine)
    at = machine
    if measurement.target_offset is not None:
        at = replace(machine, target_offset=measurement.target_offset)
    tables, covariance = tables_of_readings(motions, at, measurement.u_length_scale)
    whole = np.zeros((len(SQUARENESS) + len(covariance),) * 2)
    whole[len(SQUARENESS) :, len(SQUARENESS) :] = covariance
    return Source(name, tables, whole, ())


def is_rotary(path: str | Path, machine: Machine | None) -> bool:
    """Return whether tables, or a direct measurement of a machine, are of one with rotary axes."""
    if Path(path).suffix.lower() == '.csv':
        return machine is not None and bool(machine.rotary_names)
    return bool(load_tables(path).tables.machine.rotary_names)


def load_source(path: str | Path, machine: Machine | None) -> Source:
    """Read error_tables.json or, for the machine given, a direct measurement in CSV."""
    if Path(path).suffix.lower() == '.csv':
        if machine is None:
            raise ConfigError(f'{path}: a direct measurement needs --machine')
        return source_of_measurement(Path(path).stem, read_direct_csv(path, machine), machine)
    content = load_tables(path)
    size = len(SQUARENESS) + sum(len(content.tables.motions[m].position) for m in MOTIONS)
    covariance = unpack_covariance(content.extra.get('covariance'), size)
    name = Path(path).parent.name if Path(path).stem == 'error_tables' else Path(path).stem
    hidden = content.extra.get('not_identifiable') or ()
    return source_of_tables(name or str(path), content.tables, covariance, hidden)


def _common_grid(sources: Sequence[Source]) -> Array:
    """Points over the common range; in the plane or line that a source did not leave."""
    lows, highs = zip(*(table_ranges(s.tables) for s in sources), strict=True)
    low = np.max(lows, axis=0)
    high = np.maximum(low, np.min(highs, axis=0))
    axes = (np.unique(np.linspace(a, b, GRID_POINTS)) for a, b in zip(low, high, strict=True))
    return np.stack([g.ravel() for g in np.meshgrid(*axes, indexing='ij')], axis=1)


def _with_squareness(
    a: Source, b: Source, machine: Machine, q: Array
) -> tuple[float, float, float] | None:
    if not (a.squareness and b.squareness):
        return None
    tables = (replace(s.tables, machine=machine) for s in (a, b))
    fields = [without_rigid_motion(displacement(own, q), q) for own in tables]
    return mean_length(fields[0]), mean_length(fields[1]), mean_length(fields[1] - fields[0])


def _squareness(a: Source, b: Source, common: Common, q: Array) -> dict[str, SquarenessComparison]:
    """Squareness errors that both know, between axes that moved in both."""
    moved = {axis for axis, p in common.position.items() if len(p) > 1}
    pairs = {'C0Y': {'X', 'Y'}, 'B0Z': {'X', 'Z'}, 'A0Z': {'Y', 'Z'}}
    names = [n for n in a.squareness if n in b.squareness and pairs[n] <= moved]
    if not names:
        return {}
    values, spreads = [], []
    for source in (a, b):
        rows = squareness_rows(source, common, q)
        values.append(rows @ source.all_values)
        spreads.append(np.sqrt(np.maximum(np.diag(rows @ source.whole @ rows.T), 0.0)))
    at = [SQUARENESS.index(n) for n in names]
    return {
        n: SquarenessComparison(*(float(part[k]) for part in (*values, *spreads)))
        for n, k in zip(names, at, strict=True)
    }


def compare(a: Source, b: Source, points: Array | None = None) -> Comparison:
    """Compare two sources.

    Parameters
    ----------
    points : ndarray, shape (n, 3), m, optional
        Where error vectors are compared; a regular grid over the common ranges if not given.

    Raises
    ------
    ConfigError
        If they share no range or no motion.
    """
    common = common_ground([a, b])
    matrices = [operator(s, common) for s in (a, b)]
    values = [h @ s.values for h, s in zip(matrices, (a, b), strict=True)]
    covariances = [h @ s.covariance @ h.T for h, s in zip(matrices, (a, b), strict=True)]
    u = [np.sqrt(np.maximum(np.diag(c), 0.0)) for c in covariances]
    motions: dict[str, MotionComparison] = {}
    start = 0
    for motion in common.motions:
        position = common.position[motion.axis]
        part = slice(start, start + len(position))
        motions[motion] = MotionComparison(
            position, values[0][part], values[1][part], u[0][part], u[1][part]
        )
        start = part.stop
    q = _common_grid((a, b)) if points is None else points
    rows = vector_rows(common, q)[:, :, : -len(SQUARENESS)]
    flat = rows.reshape(-1, rows.shape[2])
    variance = np.einsum('ij,ij->i', flat @ (covariances[0] + covariances[1]), flat)
    volume = VolumeComparison(
        q,
        rows @ values[0],
        rows @ values[1],
        np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 3),
        _with_squareness(a, b, common.machine, q),
    )
    offsets = a.tables.machine.target_offset, b.tables.machine.target_offset
    squareness = _squareness(a, b, common, _common_grid((a, b)))
    return Comparison((a.name, b.name), offsets, common, motions, squareness, volume)


def agreement(normalised: Array) -> float:
    """Share of normalised errors that do not exceed 1; nan without any uncertainty."""
    known = normalised[np.isfinite(normalised)]
    return float(np.mean(known <= 1.0)) if known.size else float('nan')

# SPDX-License-Identifier: Apache-2.0
"""Error tables of several sources in one convention, and two of them compared (paper 2.3).

The convention, covariance included: motions are zero at the axis' zero position, else at the
minimum that all know, and straightness at both ends of the common range; the least-squares line
of the motions of a rotary axis is taken off them. What these choices take out of the motions is
squareness, location errors, or a rigid motion of the table, of no meaning. A rotation that one
source cannot see, because it acts on the target over a lever that no axis changes which moved
there, is a translation for it, at its own target offset and place; it is counted as that one in
all. All of it is linear: vector = M (scalars, nodes), covariance = M C M'.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.direct import DirectMeasurement, read_direct_csv, tables_of_measurement
from otf_core.errors import ConfigError
from otf_core.exports.foreign_tables import holds_foreign_tables, read_foreign_tables
from otf_core.inputs.path_file import looks_like_json
from otf_core.model.chain import Sight, has_constant_lever, rotations, turn_as_translation
from otf_core.model.evaluation import rigid_columns
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS, ErrorMotion, location_names
from otf_core.model.nodes import hat_matrix
from otf_core.model.tables import ErrorTables
from otf_core.prediction.calibration_document import CalibrationDocument, load_tables
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.predict import Predictor
from otf_core.prediction.volumetric import table_places, table_rows, table_values

SAME_LEVER = 1e-5
"""m; levers that differ by less are one: 1 nm for 100 urad."""
SAME_LINE = 1e-6
"""m, or 1 for directions; nominal lines of rotary axes that differ by less are one."""
SAME_PLACE = 1e-6
"""m and rad; positions that differ by less are one."""
RANK = 1e-9
"""Relative size of singular values that count as zero."""
COVERAGE_FACTOR = 2.0
"""k of the expanded uncertainties."""
GRID_POINTS, GRID_POINTS_OF_MANY = 7, 5
"""Points per axis of the volume: up to three axes, and more."""


@dataclass(frozen=True)
class Source:
    """Error tables and where they come from.

    Attributes
    ----------
    covariance : ndarray, shape (m, m)
        Of scalars (squareness and location errors) and the nodes of all motions.
    hidden : frozenset of str
        Errors that the source does not determine.
    change : ndarray, shape (m, m)
        The part of the covariance that does not repeat: what a change is judged by.
    """

    name: str
    tables: ErrorTables
    covariance: Array
    hidden: frozenset[str]
    change: Array


def source_of_tables(name: str, content: CalibrationDocument) -> Source:
    """Source of error tables, values independent where they hold no covariance."""
    known = Predictor.of(content)
    packed, run = content.covariance_change, known.covariance_run
    own = packed.unpack(len(run)) if packed is not None else None
    change = run if own is None else own
    return Source(name, known.tables, known.covariance, frozenset(known.not_seen), change)


def source_of_measurement(name: str, measurement: DirectMeasurement, machine: Machine) -> Source:
    """Source of a direct measurement: means over runs and directions, u from their scatter."""
    tables, covariance = tables_of_measurement(measurement, machine)
    hidden = {*machine.scalars, *(m for m, t in tables.motions.items() if not t.identifiable)}
    return Source(name, tables, covariance, frozenset(hidden), covariance)


def load_sources(
    paths: Sequence[str | Path], machine: Machine | None = None, sign: str | None = None
) -> tuple[list[Source], list[str]]:
    """Read error_tables.json, direct measurements in CSV, and tables of other systems.

    Parameters
    ----------
    machine : Machine, optional
        Of what does not hold it itself; that of the first error_tables.json if not given.
    sign : 'error' or 'correction', optional
        What values of other systems are, where their file does not say it.

    Returns
    -------
    sources : list of Source
    remarks : list of str
        What was taken for what.
    """
    documents = [load_tables(path) if looks_like_json(path) else None for path in paths]
    machines = [content.tables.machine for content in documents if content is not None]
    machine = machine or next(iter(machines), None)
    sources: list[Source] = []
    remarks: list[str] = []
    for path, content in zip(map(Path, paths), documents, strict=True):
        name = path.parent.name if path.stem == 'error_tables' else path.stem
        if content is None and machine is None:
            raise ConfigError(f'{path}: does not hold its machine; give --machine machine.yaml')
        if content is None and not holds_foreign_tables(path):
            assert machine is not None
            measurement = read_direct_csv(path, machine)
            sources.append(source_of_measurement(name, measurement, machine))
            remarks += [f'{path}: {text}' for text in measurement.remarks]
            continue
        if content is None:
            assert machine is not None
            read = read_foreign_tables(path, machine, sign)
            content = CalibrationDocument.of_tables(read.tables)
            remarks += [f'{path}: {text}' for text in read.remarks]
        sources.append(source_of_tables(name or str(path), content))
    return sources, remarks


@dataclass(frozen=True)
class Lever:
    """Where a rotation acts as a translation: target offset of a machine, place of its axes."""

    machine: Machine
    place: Array

    def translations(self, motion: ErrorMotion, position: Array) -> Array:
        """Translations per rad at positions (n,) of the axis that turns, shape (n, 3), m."""
        q = np.tile(self.place, (len(position), 1))
        q[:, self.machine.column(motion.axis)] = position
        return turn_as_translation(self.machine, motion, q)


@dataclass(frozen=True)
class Common:
    """What sources share, as vectors: motions at common positions, then scalars.

    Attributes
    ----------
    machine : Machine
        That of the first, with its target offset.
    position : mapping of axis to ndarray, m and rad
        Positions at which motions are compared: all nodes within the range that all cover.
    folded : mapping of rotation to Lever
        Rotations counted as translations, as the source that cannot see them has them.
    apart : tuple of ErrorMotion
        Those of them that several sources cannot see, over other levers: the translations of
        these sources differ by what no source knows.
    motions : tuple of ErrorMotion
        Motions that all know, folded ones left out.
    scalars : tuple of str
        Squareness and location errors that all know and the common range shows.
    not_compared : mapping of str to str
        All other errors, folded ones left out, and why.
    """

    machine: Machine
    position: Mapping[str, Array]
    folded: Mapping[ErrorMotion, Lever]
    apart: tuple[ErrorMotion, ...]
    motions: tuple[ErrorMotion, ...]
    scalars: tuple[str, ...]
    not_compared: Mapping[str, str]

    @cached_property
    def parts(self) -> dict[str, slice]:
        """Place of every motion and scalar in a vector."""
        sizes = [*(len(self.position[m.axis]) for m in self.motions), *(1 for _ in self.scalars)]
        ends = np.cumsum([0, *sizes]).tolist()
        names = [*map(str, self.motions), *self.scalars]
        return {n: slice(a, b) for n, a, b in zip(names, ends[:-1], ends[1:], strict=True)}

    @cached_property
    def grid(self) -> Array:
        """Lattice over the common range, shape (n, k), m and rad."""
        return self._lattice(lambda own, at: at)

    @cached_property
    def _node_grid(self) -> Array:
        """The same at common positions, between which lines are bent."""
        return self._lattice(lambda own, at: own[np.abs(own[:, None] - at).argmin(axis=0)])

    def _lattice(self, chosen: Callable[[Array, Array], Array]) -> Array:
        count = GRID_POINTS if len(self.position) <= 3 else GRID_POINTS_OF_MANY
        along = [
            np.unique(chosen(own, np.linspace(own[0], own[-1], count)))
            for own in self.position.values()
        ]
        return np.stack([g.ravel() for g in np.meshgrid(*along, indexing='ij')], axis=1)

    def rows(self, q: Array) -> Array:
        """From a vector to the errors at positions (n, k), m and rad; shape (3 n, m)."""
        machine, seen = self.machine, Sight.of_tool(self.machine).at(q)
        at = machine.wrapped(q)
        hats = {a: hat_matrix(p, at[:, machine.column(a)]) for a, p in self.position.items()}
        found = [
            seen.motions[m.axis][:, :, DIRECTIONS.index(m.direction), None]
            * hats[m.axis][:, None, :]
            for m in self.motions
        ]
        found += [seen.scalars[n][:, :, None] for n in self.scalars]
        return np.concatenate(found, axis=2).reshape(3 * len(q), -1)

    def free_rows(self, q: Array) -> Array:
        """The same less the rigid motion that fits the errors on the grid best."""
        columns, on_grid = (self._rigid(at) for at in (q, self.grid))
        rigid = np.linalg.pinv(on_grid, rcond=RANK) @ self.rows(self.grid)
        return np.asarray(self.rows(q) - columns @ rigid)

    @cached_property
    def field_rows(self) -> Array:
        """From a vector to the errors on the grid, rigid motion removed, shape (3 n, m)."""
        return self.free_rows(self.grid)

    def _rigid(self, q: Array) -> Array:
        return rigid_columns(Sight.of_tool(self.machine).nominal(q)).reshape(-1, 6)

    @cached_property
    def _shapes(self) -> tuple[Array, Array]:
        """Errors on the grid per unit of all scalars and six rigid motions, and their inverse."""
        seen = Sight.of_tool(self.machine).at(self._node_grid).scalars
        columns = [seen[n].reshape(-1, 1) for n in self.machine.scalars]
        shapes = np.hstack([*columns, self._rigid(self._node_grid)])
        return shapes, np.linalg.pinv(shapes, rcond=RANK)

    @property
    def shown(self) -> tuple[str, ...]:
        """Scalars that the errors on the grid show, whatever the table is moved by."""
        shapes, inverse = self._shapes
        resolution = np.einsum('ij,ji->i', inverse, shapes)
        return tuple(
            n for n, r in zip(self.machine.scalars, resolution, strict=False) if r > 1 - 1e-6
        )

    def matrix(self, source: Source) -> Array:
        """From scalars and nodes of a source to its vector, shape (m, m of the source).

        Its scalars are those that leave nothing, but a rigid motion, of what the source knows less
        the motions of the vector.
        """
        places = table_places(source.tables)
        motions = np.zeros((sum(len(self.position[m.axis]) for m in self.motions),
                            len(source.covariance)))  # fmt: skip
        for motion in self.motions:
            at, rows = self.position[motion.axis], motions[self.parts[motion]]
            rows[:, places[motion]] = hat_matrix(source.tables.motions[motion].position, at)
            for name, lever in self.folded.items() if motion.is_translation else ():
                if name.axis == motion.axis and name not in source.hidden:
                    hat = hat_matrix(source.tables.motions[name].position, at)
                    arm = lever.translations(name, at)[:, motion.along]
                    rows[:, places[name]] += arm[:, None] * hat
        self._apply_convention(motions)
        known = table_rows(source.tables.on(self.machine), self._node_grid)
        known = known.reshape(-1, known.shape[2])
        for name in self.machine.motions:
            if name not in self.motions and name not in self.folded:
                known[:, places[name]] = 0.0
        rest = known - self.rows(self._node_grid)[:, : len(motions)] @ motions
        wanted = [self.machine.scalars.index(n) for n in self.scalars]
        return np.vstack([motions, (self._shapes[1] @ rest)[wanted]])

    def _apply_convention(self, rows: Array) -> None:
        """Bring rows (m, any) of all motions to the convention, in place."""
        for axis, spec in self.machine.axes.items():
            for letters in (DIRECTIONS[:3], DIRECTIONS[3:]) if spec.rotary else ():
                self._take_line_off(axis, letters, rows)
        for motion in self.motions:
            at, own = self.position[motion.axis], rows[self.parts[motion]]
            if motion.is_straightness:
                share = ((at - at[0]) / (at[-1] - at[0]))[:, None]
                own -= (1.0 - share) * own[0] + share * own[-1]
            else:
                reference = np.zeros(1) if at[0] <= 0.0 <= at[-1] else at[:1]
                own -= hat_matrix(at, reference) @ own

    def _take_line_off(self, axis: str, letters: Sequence[str], rows: Array) -> None:
        """Take the least-squares line off the translations, or rotations, of a rotary axis.

        A displacement D of the line is the motion D - R D of an axis on the target side, of one on
        the table side R^-1 D - D, with R the rotation by the axis (docs/conventions.md).
        """
        own = [m for m in self.motions if m.axis == axis and m.direction in letters]
        if not own:
            return
        at, sign = self.position[axis], -1.0 if axis in self.machine.chain.table_side else 1.0
        turn = rotations(sign * at, np.array(self.machine.axes[axis].direction))
        free = [letters.index(n[0]) for n in location_names(axis) if n[0] in letters]
        moved = sign * (np.eye(3) - turn)[:, :, free]
        shapes = np.concatenate([moved[:, m.along] for m in own])
        constant = np.kron(np.eye(len(own)), np.ones((len(at), 1)))
        line = np.linalg.pinv(np.hstack([shapes, constant]), rcond=RANK)[: len(free)]
        values = slice(self.parts[own[0]].start, self.parts[own[-1]].stop)
        rows[values] -= shapes @ (line @ rows[values])


def common_ground(sources: Sequence[Source]) -> Common:
    """Find what sources share.

    Raises
    ------
    ConfigError
        If they describe different machines or share nothing.
    """
    machine = sources[0].tables.machine
    _check_one_machine(sources)
    levers: dict[ErrorMotion, list[Lever]] = {}
    for source in sources:
        own, (low, high) = source.tables.machine, table_ranges(source.tables)
        for m in own.motions:
            turns = m in source.hidden and not m.is_translation
            if turns and has_constant_lever(own, m, low, high):
                levers.setdefault(m, []).append(Lever(own, low))
    reasons = {
        n: f'{source.name} does not determine it'
        for source in sources[::-1]
        for n in map(str, (*machine.scalars, *machine.motions))
        if n in source.hidden and n not in levers
    }
    motions = tuple(m for m in machine.motions if m not in reasons and m not in levers)
    if not motions:
        raise ConfigError('the sources have no error motion in common')
    common = Common(
        machine,
        _positions(sources, {m.axis for m in motions}),
        {m: own[-1] for m, own in levers.items()},
        tuple(m for m, own in levers.items() if _span(m, own) > SAME_LEVER),
        motions,
        (),
        reasons,
    )
    unseen = [n for n in machine.scalars if n not in common.shown and n not in reasons]
    reasons |= dict.fromkeys(unseen, 'the common range does not show it')
    return replace(common, scalars=tuple(n for n in machine.scalars if n not in reasons))


def _check_one_machine(sources: Sequence[Source]) -> None:
    """Refuse tables of another machine, or of other nominal lines."""
    first = sources[0].tables.machine
    for source in sources[1:]:
        machine = source.tables.machine
        if str(machine.chain) != str(first.chain):
            raise ConfigError(
                f'{source.name}: chain {machine.chain}, but {sources[0].name} has '
                f'{first.chain}; these are different machines'
            )
        for axis in first.rotary_names:
            lines = [
                (*(m.axes[axis].direction or ()), *m.axes[axis].centre) for m in (machine, first)
            ]
            if not np.allclose(lines[0], lines[1], atol=SAME_LINE, rtol=0):
                raise ConfigError(
                    f'{source.name}: direction or centre of {axis} is not that of '
                    f'{sources[0].name}; location errors count from these, so calibrate both with '
                    f'the same ones'
                )


def _positions(sources: Sequence[Source], compared: set[str]) -> dict[str, Array]:
    """Nodes of all sources within the range that all cover, by axis."""
    lows, highs = zip(*(table_ranges(s.tables) for s in sources), strict=True)
    positions = {}
    for axis, low, high in zip(
        sources[0].tables.machine.axis_names, np.max(lows, 0), np.min(highs, 0), strict=True
    ):
        if high - low < SAME_PLACE and axis in compared:
            raise ConfigError(f'axis {axis}: the sources cover no common range')
        nodes = [
            s.tables.motions[m].position
            for s in sources
            for m in s.tables.machine.motions
            if m.axis == axis and m not in s.hidden
        ]
        inside = [n[(n > low) & (n < high)] for n in nodes]
        at = np.unique(np.concatenate([[low, max(low, high)], *inside]))
        positions[axis] = at[np.concatenate([[True], np.diff(at) > SAME_PLACE])]
    return positions


def _span(motion: ErrorMotion, levers: Sequence[Lever]) -> float:
    """Largest difference of the levers of a rotation that matters, m."""
    acting = [lever.translations(motion, np.zeros(1))[0] for lever in levers]
    return float(np.ptp(acting, axis=0).max())


# Two sources. The normalised error E_n = |a - b| / sqrt(U_a^2 + U_b^2), with U = 2 u (ISO 13528),
# is below 1 where they agree within their stated uncertainties.


@dataclass(frozen=True)
class ErrorPair:
    """One error of two sources in one convention, or their error vectors.

    Attributes
    ----------
    position : ndarray
        (k,), m or rad, of the axis of a motion; empty for an error that is one number; (k, 3), m,
        for error vectors: nominal places of the target in the frame of the table.
    a, b, u_a, u_b : ndarray, shape (k,), (1,) or (k, 3), m or rad
        Values and standard uncertainties.
    """

    position: Array
    a: Array
    b: Array
    u_a: Array
    u_b: Array

    @property
    def difference(self) -> Array:
        """Value of b less that of a."""
        return self.b - self.a

    @property
    def normalised(self) -> Array:
        """E_n; nan where the convention fixes both values, or no uncertainty is known."""
        return normalised_error(self.difference, np.hypot(self.u_a, self.u_b))


@dataclass(frozen=True)
class Comparison:
    """Two sources compared.

    Attributes
    ----------
    offsets : tuple of ndarray, shape (3,), m
        Target offsets.
    errors : mapping of str to ErrorPair
        Motions, then squareness and location errors.
    volume : ErrorPair
        Error vectors at the target offset of the first: all that both know, rigid motion removed.
    """

    names: tuple[str, str]
    offsets: tuple[Array, Array]
    common: Common
    errors: Mapping[str, ErrorPair]
    volume: ErrorPair

    @property
    def without_u(self) -> tuple[str, ...]:
        """Which of 'a' and 'b' state no uncertainty of any motion: they count as exact in E_n."""
        pairs = [p for p in self.errors.values() if p.position.size]
        stated = {'a': any(p.u_a.any() for p in pairs), 'b': any(p.u_b.any() for p in pairs)}
        return tuple(side for side, known in stated.items() if not known)


def normalised_error(difference: Array, u: Array) -> Array:
    """E_n for a difference and its standard uncertainty; nan where both are zero."""
    limit = COVERAGE_FACTOR * u
    known = limit > 1e-12 * max(float(np.abs(difference).max(initial=0.0)), 1e-12)
    return np.asarray(np.where(known, np.abs(difference) / np.where(known, limit, 1.0), np.nan))


def agreement(normalised: Array) -> float:
    """Share of normalised errors that do not exceed 1; nan without any uncertainty."""
    known = normalised[np.isfinite(normalised)]
    return float(np.mean(known <= 1.0)) if known.size else float('nan')


def compare(a: Source, b: Source, points: Array | None = None) -> Comparison:
    """Compare two sources.

    Parameters
    ----------
    points : ndarray, shape (n, k), m and rad, optional
        Axis positions at which error vectors are compared; a regular grid over the common ranges
        if not given.

    Raises
    ------
    ConfigError
        If they share no range or no motion.
    """
    common, sides = common_ground([a, b]), []
    q = common.grid if points is None else points
    rows = common.free_rows(q)
    for source in (a, b):
        matrix = common.matrix(source)
        covariance = matrix @ source.covariance @ matrix.T
        value = matrix @ table_values(source.tables)
        variances = np.diag(covariance), np.einsum('ij,ij->i', rows @ covariance, rows)
        sides.append((value, rows @ value, *(np.sqrt(np.maximum(v, 0.0)) for v in variances)))
    (a_own, a_field, u_own, u_field), (b_own, b_field, v_own, v_field) = sides
    errors = {
        name: ErrorPair(
            np.zeros(0) if name in common.scalars else common.position[name[-1]],
            *(v[part] for v in (a_own, b_own, u_own, v_own)),
        )
        for name, part in common.parts.items()
    }
    fields = (v.reshape(-1, 3) for v in (a_field, b_field, u_field, v_field))
    volume = ErrorPair(Sight.of_tool(common.machine).nominal(q), *fields)
    offsets = a.tables.machine.target_offset, b.tables.machine.target_offset
    return Comparison((a.name, b.name), offsets, common, errors, volume)

# SPDX-License-Identifier: Apache-2.0
"""Result of a calibration: tables, uncertainties, fit, headline, predictions and their display.

The headline is the volumetric error on one grid (``evaluation.lattice`` over the driven volume,
best rigid motion removed) with one coverage factor, mean beside mean and largest beside largest.
Its uncertainty includes the systematic contributions: those of machine.yaml, and typical values
for what it does not declare. pandas and matplotlib are used by ``to_frame`` and ``plot`` alone.
"""

from __future__ import annotations

import html
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.budget.budget import OBSERVED, Budget
from otf_core.budget.typical import TypicalSystematic, with_typical
from otf_core.calibration.machine_verdict import Verdict, Verdicts
from otf_core.config import OTF, STANDSTILL, CalibrationConfig
from otf_core.effects import AppliedEffect
from otf_core.effects.stated_effect import StatedEffect
from otf_core.errors import ConfigError
from otf_core.files.message_text import with_micro_sign
from otf_core.files.writing import tidy
from otf_core.model.chain import displacement, nominal_position
from otf_core.model.evaluation import VolumeErrors
from otf_core.model.expanded import micro_figure, micro_significant, micro_with_expanded
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.motions import unit_of
from otf_core.model.presets import TYPICAL
from otf_core.model.provenance import Origin
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import Misfit, NoiseModel
from otf_core.noise.standstill import LostSamples
from otf_core.pieces.pieces import Pieces
from otf_core.prediction.absorbed import OffsetBound, offset_bound
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.uncertainty import prediction_uncertainty
from otf_core.prediction.volumetric import VolumetricError, length_sizes, table_places
from otf_core.solving.reversal import AxisLag, Reversal
from otf_core.solving.tabulate import TableCost

DECLARED, PARTLY, ASSUMED = 'declared', 'partly typical', 'typical'


@dataclass(frozen=True)
class ExpectedRemainder:
    """Expanded uncertainty of the error vectors on a grid: what compensation will leave.

    Attributes
    ----------
    expanded : mapping of 'mean', 'p95', 'max' to float, m
        Systematic contributions included.
    observed : mapping of the same, m
        Nothing systematic: what is seen to scatter.
    k : float
        Coverage factor of both.
    assumed : tuple of str
        Contributions for which typical values stand, as the budget calls them.
    nothing_declared : bool
        True if machine.yaml declares no contribution at all.
    """

    expanded: Mapping[str, float]
    observed: Mapping[str, float]
    k: float
    assumed: tuple[str, ...]
    nothing_declared: bool

    @property
    def systematic(self) -> str:
        """'declared', 'typical' or 'partly typical': where systematic contributions come from."""
        if not self.assumed:
            return DECLARED
        return ASSUMED if self.nothing_declared else PARTLY

    @property
    def label(self) -> str:
        """The same in a few words."""
        return {
            DECLARED: 'systematic contributions as declared',
            PARTLY: f'systematic contributions as declared; {", ".join(self.assumed)} typical, '
            f'not declared',
            ASSUMED: 'systematic contributions typical, not declared in machine.yaml',
        }[self.systematic]

    @property
    def expanded_words(self) -> str:
        """What is to be expected after compensation."""
        return (
            f'expected after compensation: {self._sizes(self.expanded)} '
            f'(U, k = {self.k:.3g}; {self.label})'
        )

    @property
    def observed_words(self) -> str:
        """The part that holds nothing systematic."""
        return f'noise and misfit of this run alone: {self._sizes(self.observed)} (U)'

    @property
    def forecast_words(self) -> str:
        """The same part before anything is measured."""
        return f'noise of the tracker alone: {self._sizes(self.observed)} (U)'

    def _sizes(self, sizes: Mapping[str, float]) -> str:
        return ', '.join(
            f'{word} {micro_significant(sizes[name])}'
            for word, name in (('mean', 'mean'), ('largest', 'max'))
        )

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, SI."""
        return {
            'expected_after_compensation': {
                'U': dict(self.expanded),
                'k': self.k,
                'systematic': self.systematic,
                'typical_for': list(self.assumed),
                'presets': list(TYPICAL) if self.assumed else [],
            },
            'label': self.label,
            'noise_and_misfit_alone': {'U': dict(self.observed), 'k': self.k},
        }


@dataclass(frozen=True)
class Headline(ExpectedRemainder):
    """Volumetric error and its expanded uncertainty on one grid.

    Attributes
    ----------
    points : int
        Of the grid over the driven volume.
    error : mapping of 'mean', 'p95', 'max' to float, m
        Lengths of the error vectors as found.
    of_largest : float, m
        Expanded uncertainty of the length of the largest error vector.
    """

    points: int
    error: Mapping[str, float]
    of_largest: float

    @property
    def error_words(self) -> str:
        """The volumetric error as found."""
        mean = micro_figure(self.error['mean'], self.expanded['mean'])
        largest = micro_with_expanded(self.error['max'], self.of_largest)
        return f'volumetric error as found: mean {mean}, largest {largest}'

    @property
    def words(self) -> tuple[str, str, str]:
        """Three lines: error, uncertainty, noise alone."""
        return self.error_words, self.expanded_words, self.observed_words

    def to_dict(self) -> dict[str, Any]:
        """Entry ``headline`` of error_tables.json, SI."""
        return {
            'unit': 'm',
            'points': self.points,
            'rigid_motion': 'taken out',
            'error': dict(self.error),
            'U_of_largest': self.of_largest,
            **super().to_dict(),
            'sentences': list(self.words),
        }


def covariance_with_typical(
    covariance: Array, budget: Budget, typical: TypicalSystematic | None
) -> Array:
    """Covariance (m, m) of the tables with typical values where nothing is declared."""
    if typical is None:
        return covariance
    change = budget.rows @ typical.change
    return np.asarray(covariance + change @ change.T)


def expanded_of(
    tables: ErrorTables, covariance: Array, budget: Budget, hidden: Collection[str]
) -> dict[str, Array]:
    """Expanded uncertainty of scalars (1,) and nodes (k,), m and rad; zero of what is hidden.

    Parameters
    ----------
    covariance : ndarray, shape (m, m)
        Of scalars and nodes, typical contributions included.
    budget : Budget
        With typical contributions, for the coverage factors.
    """
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    variances, values = budget.variances(), {}
    for name, place in table_places(tables).items():
        k, _ = budget.expansion(variances[:, place])
        values[name] = k * u[place] * (name not in hidden)
    return values


def headline_of(
    volume: VolumetricError, budget: Budget, typical: TypicalSystematic | None
) -> Headline:
    """Work out the headline of a calibration.

    Parameters
    ----------
    volume : VolumetricError
        Of the tables.
    budget : Budget
        With typical contributions where nothing is declared, see ``typical.with_typical``.
    typical : TypicalSystematic, optional
        None if all is declared.
    """
    variances = budget.variances(volume.rows)
    k, _ = budget.expansion(variances)
    own = np.array([name in OBSERVED for name in budget.names])
    at = int(np.argmax(volume.length))
    longest = budget.variances(volume.length_rows[[at]]).sum()

    def sizes(parts: Array) -> dict[str, float]:
        variance = parts.sum(axis=0).reshape(-1, 3)
        return length_sizes(k * np.sqrt(variance.sum(axis=1)))

    return Headline(
        expanded=sizes(variances),
        observed=sizes(variances[own]),
        k=k,
        assumed=typical.missing if typical else (),
        nothing_declared=typical is not None and typical.nothing_declared,
        points=len(volume.grid),
        error=volume.sizes(),
        of_largest=k * float(np.sqrt(longest)),
    )


COLUMNS = (
    'error', 'axis', 'position', 'position_unit', 'value', 'unit', 'u', 'identifiable', 'U', 'k',
    'U_with_typical', 'target_offset',
)  # fmt: skip
WIDTH, HEIGHT = 2.6, 2.2
"""inch; of a panel of the figure."""


def _optional(module: str, needs: str) -> Any:
    """A module that the package does without; ConfigError if it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        name = module.partition('.')[0]
        raise ConfigError(
            f'{needs} needs the package {name}, which is not installed: pip install {name}'
        ) from None


def coverage_factors(tables: ErrorTables, budget: Budget) -> dict[str, float]:
    """Coverage factor of every motion and squareness error; NaN where nothing is known."""
    variances, factors = budget.variances(), {}
    for name, part in table_places(tables).items():
        own = variances[:, part]
        known = own[:, own.sum(axis=0) > 0]
        factors[name] = budget.expansion(known)[0] if known.size else math.nan
    return factors


def table_html(result: CalibrationResult) -> str:
    """The same as rows, and scalars; what else there is in a line."""
    head, verdicts = result.headline, result.verdicts
    lines = [*head.words[:2], verdicts.measurement_words, verdicts.machine_words]
    rows = []
    scalars = result.tables.machine.scalars
    for name in scalars:
        value, wide = result.tables.scalar(name), float(result.expanded[name][0])
        seen = name not in result.not_identifiable
        shown = micro_with_expanded(value, wide, unit_of(name)) if seen else 'not seen'
        bound = result.offset_bound.words(name)
        kind = 'location' if name in result.tables.location else 'squareness'
        rows.append((f'{kind} {name}', f'{shown}, {bound}' if bound else shown))
    unseen = [n for n in result.not_identifiable if n not in scalars]
    if unseen:
        rows.append(('not seen', ', '.join(unseen)))
    offset = ', '.join(f'{1e3 * v:.1f}' for v in result.tables.machine.target_offset)
    rows.append(('target offset', f'({offset}) mm'))
    cells = ''.join(f'<tr><th>{_typeset(a)}</th><td>{_typeset(b)}</td></tr>' for a, b in rows)
    words = '<br>'.join(map(_typeset, lines))
    return (
        f'<p><b>{_typeset(result.tables.machine.name)}</b><br>{words}</p><table>{cells}</table>'
        '<p>All errors: <code>to_frame()</code>, <code>plot()</code></p>'
    )


def _typeset(text: str) -> str:
    """Escaped for HTML, with proper signs."""
    return html.escape(with_micro_sign(text).replace('+/-', '±'))


def table_cells(result: CalibrationResult) -> list[tuple[Any, ...]]:
    """All nodes and scalars, a row under ``COLUMNS`` each."""
    tables, bound = result.tables, result.offset_bound
    factors, rows = coverage_factors(tables, result.budget_with_typical), list[tuple[Any, ...]]()
    for name in (*map(str, tables.machine.motions), *tables.machine.scalars):
        k, unit, whole = factors[name], unit_of(name), result.expanded[name].tolist()
        offset = tuple(map(float, bound.offset)) if name in bound.contains else None
        if name in tables.machine.scalars:
            seen = name not in result.not_identifiable
            nodes = [(math.nan, tables.scalar(name) + 0.0, tables.scalar_u(name), seen)]
            axis = along = ''
        else:
            table, axis = tables.motions[name], name[2]
            along, seen = tables.machine.axes[axis].unit, table.nodes_seen.tolist()
            nodes = list(zip(map(tidy, table.position), (table.value + 0.0).tolist(),
                             table.u.tolist(), seen, strict=True))  # fmt: skip
        rows += [
            (name, axis, at, along, value, unit, u, seen, k * u if u > 0.0 else 0.0, k, wide,
             offset)
            for (at, value, u, seen), wide in zip(nodes, whole, strict=True)
        ]  # fmt: skip
    return rows


def data_frame(result: CalibrationResult) -> Any:
    """The same as a data frame; see ``CalibrationResult.to_frame``."""
    module = _optional('pandas', 'CalibrationResult.to_frame()')
    tables = result.tables
    frame = module.DataFrame(table_cells(result), columns=list(COLUMNS))
    frame.attrs = {
        'machine': tables.machine.name,
        'chain': tables.machine.chain,
        'target_offset': tables.machine.target_offset.tolist(),
        'run_id': result.run_id,
    }
    return frame


def figure(result: CalibrationResult) -> Any:
    """All error motions over the position, with bands; see ``CalibrationResult.plot``."""
    pyplot = _optional('matplotlib.pyplot', 'CalibrationResult.plot()')
    tables = result.tables
    names = tables.machine.axis_names
    drawn, panels = pyplot.subplots(
        len(names),
        6,
        figsize=(6 * WIDTH, len(names) * HEIGHT),
        squeeze=False,
        layout='constrained',
    )
    for panel, motion in zip(panels.flat, tables.machine.motions, strict=True):
        table, axis = tables.motions[motion], tables.machine.axes[motion.axis]
        factor, unit = axis.shown
        panel.set_title(str(motion), fontsize='medium')
        panel.set_xlabel(f'{motion.axis} ({unit})')
        panel.set_ylabel('µm' if unit_of(motion) == 'm' else 'µrad')
        if not table.identifiable:
            panel.set(xticks=[], yticks=[])
            panel.text(0.5, 0.5, 'not seen', ha='center', transform=panel.transAxes)
            continue
        wide = result.expanded[motion]
        low, high = 1e6 * (table.value - wide), 1e6 * (table.value + wide)
        panel.fill_between(factor * table.position, low, high, alpha=0.3, linewidth=0)
        panel.plot(factor * table.position, 1e6 * table.value, marker='o', markersize=3)
        panel.grid(alpha=0.3)
    label = result.headline.label
    drawn.suptitle(f'{tables.machine.name}: error motions with U ({label})', fontsize='medium')
    return drawn


GAUGE = (
    'positioning and rotations zero at axis position 0, else at the minimum; '
    'straightness zero at both ends; its slope lies in squareness and alignment'
)
LINES_GAUGE = (
    'rotary axes: all six motions zero at position 0, else at the minimum; location errors are '
    'the least-squares line over the nodes'
)


def gauge_of(machine: Machine) -> str:
    """What is zero by definition in the tables of a machine."""
    return '; '.join([GAUGE, LINES_GAUGE] if machine.location else [GAUGE])


@dataclass(frozen=True)
class Fit:
    """Size and quality of a fit.

    Attributes
    ----------
    unknowns, rank : int
        Free unknowns after the gauge; combinations of them that the data determine.
    coverage : float
        Driven share of the path length.
    path_mae_before, path_mae_after : float
        Mean perpendicular distance from the path, m: rigidly aligned, and compensated.
    residual_rms : float
        Root mean square of the perpendicular residual, m.
    residual_ratio : float
        Residual of the pieces over the noise specified for single samples, root mean square.
    variance_ratio, correlation_factor : float
        See ``uncertainty.ResidualCheck``.
    inflation : float
        Factor on the covariance that these two call for.
    """

    samples: int
    used: int
    outliers: int
    pieces: int
    unknowns: int
    rank: int
    coverage: float
    path_mae_before: float
    path_mae_after: float
    residual_rms: float
    residual_ratio: float
    variance_ratio: float
    correlation_factor: float
    inflation: float
    iterations: int


@dataclass(frozen=True)
class DrivenPart:
    """A part of a run between two places of the reflector.

    Attributes
    ----------
    target : str
        Name of the reflector.
    corners : int
        Of its path.
    driven : float
        Share of its path that was driven.
    moved : tuple of str
        Axes that moved the reflector in view of the tracker.
    """

    target: str
    corners: int
    driven: float
    moved: tuple[str, ...]


@dataclass(frozen=True)
class TargetPlace:
    """Place of a reflector in the frame of its link, and its standard uncertainty, m, (3,)."""

    link: str
    place: Array
    u: Array


@dataclass(frozen=True)
class RunResult:
    """One run of a calibration.

    Attributes
    ----------
    name : str
        Of the recording.
    target_offset : ndarray, shape (3,), m
    remarks : tuple of str
        What was repaired or left out while the recording was read.
    rate : float
        Hz, usual rate of the samples.
    lost : LostSamples
        Samples missing according to the stamps.
    T_machine_tracker : RigidTransform
        To the link that the tracker stands on.
    noise : NoiseModel
        Noise of single samples as the residuals show it.
    misfit : Misfit
        What the model leaves besides.
    parts : tuple of DrivenPart
        In driving order.
    coverage : float
        Driven share of the path length.
    part : ndarray of int64, shape (p,)
        Number of the part of every piece, from 0.
    q : ndarray, shape (p, k), m and rad
        Nominal axis positions of every piece.
    speed : ndarray, shape (p,), m/s
        Of the target.
    axes : ndarray, shape (c, p, 3)
        Directions in which deviations are stated: two perpendicular to the path.
    aligned : ndarray, shape (c, p), m
        Rigidly aligned measurement minus path.
    deviation, residual : ndarray, shape (c, p), m
        Measurement in the pose of the solution minus path, before and after compensation.
    """

    name: str
    target_offset: Array
    samples: int
    remarks: tuple[str, ...]
    rate: float
    lost: LostSamples
    T_machine_tracker: RigidTransform
    noise: NoiseModel
    misfit: Misfit
    parts: tuple[DrivenPart, ...]
    coverage: float
    pieces: Pieces
    part: Index
    q: Array
    speed: Array
    axes: Array
    aligned: Array
    deviation: Array
    residual: Array


@dataclass(frozen=True)
class CalibrationResult:
    """Everything a calibration found.

    Attributes
    ----------
    run_id : str
        Hash of samples, paths, machine and configuration.
    covariance : ndarray, shape (m, m)
        Of ``Machine.scalars`` and the nodes of ``Machine.motions``, m and rad: all sources.
    targets : mapping of target to TargetPlace
        Of the reflectors whose places were sought.
    headline : Headline
        What is stated first: volumetric error and its expanded uncertainty.
    reversal : Reversal
        How the motions differ between forward and backward travel; ``tables`` hold the mean.
    lags : tuple of AxisLag
        Axes that are late behind the others.
    fraction : int
        Nodes of the tables stand ``table_pitch / fraction`` apart.
    table_costs : mapping of fraction to TableCost
        What straight lines between the nodes cost, for 1 and for the fraction taken.
    prior : mapping of motion to float
        Standard deviations of rotations that were not seen, rad: they count for another tool.
    not_identifiable : tuple of str
        Errors the data cannot see.
    advice : mapping of name to str
        What would show an error that the data do not show.
    typical : TypicalSystematic, optional
        What typical systematic contributions would add; None if all are declared.
    failed_gates : tuple of str
        Quality gates of the measurement that failed; empty for a good one.
    origin : tuple of Origin
        The recordings.
    effects : tuple of StatedEffect
        Taken off the runs before the tables were solved for.
    effects_sentence : str
        Effects found and removed; empty without ``--effects``.
    applied : tuple of tuple of AppliedEffect
        What was taken off, run by run.
    uncorrected : CalibrationResult, optional
        The one without that; None where nothing was taken off.
    machine_verdict : Verdict, optional
        By the limits of machine.yaml; None without any.
    """

    run_id: str
    tables: ErrorTables
    covariance: Array
    budget: Budget
    runs: tuple[RunResult, ...]
    targets: Mapping[str, TargetPlace]
    fit: Fit
    headline: Headline
    reversal: Reversal
    lags: tuple[AxisLag, ...]
    fraction: int
    table_costs: Mapping[int, TableCost]
    prior: Mapping[str, float]
    not_identifiable: tuple[str, ...]
    advice: Mapping[str, str]
    typical: TypicalSystematic | None
    warnings: tuple[str, ...]
    failed_gates: tuple[str, ...]
    config: CalibrationConfig
    origin: tuple[Origin, ...] = ()
    effects: tuple[StatedEffect, ...] = ()
    effects_sentence: str = ''
    applied: tuple[tuple[AppliedEffect, ...], ...] = ()
    uncorrected: CalibrationResult | None = None
    machine_verdict: Verdict | None = None

    @property
    def plain(self) -> CalibrationResult:
        """The calibration without effects taken off."""
        return self.uncorrected or self

    @property
    def method(self) -> str:
        """'otf', or 'standstill': only the stops at the corners."""
        return STANDSTILL if self.runs[0].pieces.standstill else OTF

    @property
    def needs(self) -> list[str]:
        """What would show the errors that the data do not show, one line for those of one need."""
        by_need: dict[str, list[str]] = {}
        for name, need in self.advice.items():
            by_need.setdefault(need, []).append(name)
        return [f'{", ".join(names)}: needs {need}' for need, names in by_need.items()]

    @property
    def verdicts(self) -> Verdicts:
        """Is the measurement good; is the machine within its limits."""
        return Verdicts(self.failed_gates, self.machine_verdict)

    @property
    def sentence(self) -> str:
        """The outcome."""
        verdicts = self.verdicts
        if not verdicts.good:
            return verdicts.measurement_words
        error, expected, _ = self.headline.words
        return '; '.join([error, expected, verdicts.measurement_words, verdicts.machine_words])

    @cached_property
    def budget_with_typical(self) -> Budget:
        """The budget with typical values where nothing is declared: that of the headline."""
        return with_typical(self.budget, self.typical)

    @cached_property
    def covariance_with_typical(self) -> Array:
        """Covariance with them, in the order of ``covariance``."""
        return covariance_with_typical(self.covariance, self.budget, self.typical)

    @cached_property
    def volume(self) -> VolumetricError:
        """Errors over the volume of the tables, with the uncertainty of the headline."""
        return VolumetricError(self.tables, self.covariance_with_typical)

    @cached_property
    def offset_bound(self) -> OffsetBound:
        """Values that hold at the target offset of the measurement only."""
        return offset_bound(self.tables.machine, self.not_identifiable)

    @cached_property
    def expanded(self) -> dict[str, Array]:
        """Expanded uncertainty of scalars (1,) and nodes (k,), m and rad.

        That of the headline: with typical values where nothing is declared; zero where a value
        is not identifiable.
        """
        covariance, budget = self.covariance_with_typical, self.budget_with_typical
        return expanded_of(self.tables, covariance, budget, self.not_identifiable)

    @property
    def T_machine_tracker(self) -> RigidTransform:
        """Pose of the tracker in the first run."""
        return self.runs[0].T_machine_tracker

    def to_frame(self) -> Any:
        """All errors as a data frame of pandas, SI units, a row for every node.

        Returns
        -------
        pandas.DataFrame
            ``error`` (C0Y ... EXX ...), ``axis``, ``position`` (in ``position_unit``; NaN for
            scalars), ``value`` (m or rad, actual minus nominal), ``unit`` (of the value), ``u``
            (standard uncertainty of what the budget holds), ``identifiable``, ``U``, ``k``: as in
            error_tables.csv. ``U_with_typical`` is U with typical systematic contributions where
            none are declared, ``target_offset`` the offset (m) at which alone a value holds, None
            if at any. ``attrs`` hold machine, chain, run_id and target_offset.

        Raises
        ------
        ConfigError
            If pandas is not installed.

        Examples
        --------
        >>> frame = result.to_frame()  # doctest: +SKIP
        >>> frame[frame.error == 'EXX'].plot('position', 'value', yerr='U')  # doctest: +SKIP
        """
        return data_frame(self)

    def plot(self) -> Any:
        """Draw all error motions with matplotlib: micrometres and microradians over millimetres.

        Bands are expanded uncertainties with the systematic contributions, as in the headline.

        Returns
        -------
        matplotlib.figure.Figure
            Made with pyplot: a notebook shows it, a script calls ``savefig`` on it.

        Raises
        ------
        ConfigError
            If matplotlib is not installed.

        Examples
        --------
        >>> result.plot().savefig('motions.png')  # doctest: +SKIP
        """
        return figure(self)

    def __repr__(self) -> str:
        return f'<CalibrationResult {self.tables.machine.name}: {self.sentence}>'

    def _repr_html_(self) -> str:
        return table_html(self)


POSITIONS = (5, 3)
"""Positions of every axis on the grid of ``volume_errors`` up to three axes, and of more."""
TURN_POSITIONS = 4
"""Positions of every rotary axis."""


def volume_errors(
    result: CalibrationResult, provisional: bool = False, count: int | None = None
) -> VolumeErrors:
    """Return the errors on a grid over the ranges of the tables, ``count`` positions an axis."""
    tables, machine = result.tables, result.tables.machine
    count = count or POSITIONS[len(machine.axis_names) > 3]
    lines = []
    for axis, low, high in zip(machine.axis_names, *table_ranges(tables), strict=True):
        own = machine.axes[axis]
        number = 1 if high <= low else TURN_POSITIONS if own.rotary else count
        lines.append(np.linspace(low, high, number, endpoint=not own.endless))  # no turn twice
    q = np.stack([g.ravel() for g in np.meshgrid(*lines, indexing='ij')], axis=1)
    nodes: dict[str, Array] = {m: tables.motions[m].position for m in machine.motions}
    u = prediction_uncertainty(machine, nodes, result.covariance, q)
    points, errors = nominal_position(machine, q), displacement(tables, q)
    return VolumeErrors(points, errors, u, provisional, machine.axis_names, q)


def motion_sizes(tables: ErrorTables) -> dict[str, tuple[float, float]]:
    """Return of every motion the largest absolute error and the largest u of a node, m or rad.

    u is NaN where the samples do not determine the motion.
    """
    sizes: dict[str, tuple[float, float]] = {}
    for name in tables.machine.motions:
        table = tables.motions[name]
        seen = table.u[table.nodes_seen]
        known = table.identifiable and len(seen) > 0
        u = float(seen.max()) if known else float('nan')
        sizes[name] = float(np.abs(table.value).max()), u
    return sizes

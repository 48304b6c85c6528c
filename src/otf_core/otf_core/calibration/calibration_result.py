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
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.budget.budget import OBSERVED, Budget
from otf_core.budget.lines import BudgetLine, budget_lines
from otf_core.budget.typical import TypicalSystematic
from otf_core.calibration.document import document_of
from otf_core.config import CalibrationConfig
from otf_core.effects import AppliedEffect
from otf_core.errors import ConfigError
from otf_core.files.message_text import with_micro_sign
from otf_core.files.writing import tidy
from otf_core.model.chain import displacement, nominal_position
from otf_core.model.evaluation import VolumeErrors
from otf_core.model.expanded import micro_figure, micro_with_expanded
from otf_core.model.frames import RigidTransform
from otf_core.model.motions import unit_of
from otf_core.model.provenance import Origin
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import Misfit, NoiseModel
from otf_core.noise.standstill import LostSamples
from otf_core.pieces.pieces import Pieces
from otf_core.prediction.absorbed import OffsetBound, offset_bound
from otf_core.prediction.calibration_document import (
    CalibrationDocument,
    DrivenPart,
    Fit,
    Headline,
    Remainder,
    StatedEffect,
    TargetPlace,
    Verdicts,
    systematic_fields,
)
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.uncertainty import prediction_uncertainty
from otf_core.prediction.volumetric import VolumetricError, length_sizes, table_places
from otf_core.solving.reversal import AxisLag, Reversal
from otf_core.solving.tabulate import TableCost


def headline_of(
    volume: VolumetricError,
    budget: Budget,
    typical: TypicalSystematic | None,
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
    longest = float(np.sqrt(budget.variances(volume.length_rows[[at]]).sum()))

    def sizes(parts: Array) -> dict[str, float]:
        variance = parts.sum(axis=0).reshape(-1, 3)
        return length_sizes(np.sqrt(variance.sum(axis=1)))

    missing, nothing = (typical.missing, typical.nothing_declared) if typical else ((), False)
    left = Remainder(
        u=sizes(variances), u_run=sizes(variances[own]), k=k, **systematic_fields(missing, nothing)
    )
    error, sized = volume.sizes(), left.expanded
    mean = micro_figure(error['mean'], sized['mean'])
    largest = micro_with_expanded(error['max'], k * longest)
    return Headline(
        **vars(left),
        points=len(volume.grid),
        error=error,
        u_of_largest=longest,
        sentences=(
            f'volumetric error as found: mean {mean}, largest {largest}',
            left.expanded_words,
            f'noise and misfit of this run alone: {left.observed_words}',
        ),
    )


COLUMNS = (
    'error', 'axis', 'position', 'position_unit', 'value', 'unit', 'u', 'u_run', 'identifiable',
    'k', 'target_offset',
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


def table_html(result: CalibrationResult) -> str:
    """The same as rows, and scalars; what else there is in a line."""
    lines = [*result.headline.sentences[:2], *result.verdicts.words[:2]]
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


def _cells(name: str, own: tuple[Any, ...], offset: Any, *node: Any) -> tuple[Any, ...]:
    """One row under ``COLUMNS``."""
    (axis, along, unit, k, bound), (at, value, u, u_run, seen) = own, node
    k = math.nan if k is None else k
    return (name, axis, at, along, value, unit, u, u_run, seen, k, offset if bound else None)


def table_cells(document: CalibrationDocument) -> list[tuple[Any, ...]]:
    """All nodes and scalars, a row under ``COLUMNS`` each."""
    bound, rows = document.target_offset_bound, list[tuple[Any, ...]]()
    contains = bound.contains if bound else {}
    offset = tuple(map(float, bound.offset)) if bound else None
    for name, table in document.motions.items():
        seen = table.nodes_seen.tolist()
        nodes = (table.value + 0.0, table.u, table.u if table.u_run is None else table.u_run)
        places = zip(map(tidy, table.position), *(v.tolist() for v in nodes), seen, strict=True)
        own = (table.axis, table.position_unit, unit_of(name), table.k, contains.get(name))
        rows += [_cells(name, own, offset, *place) for place in places]
    for name, scalar in {**document.squareness, **document.location}.items():
        own = ('', '', unit_of(name), scalar.k, contains.get(name))
        size = (scalar.value + 0.0, scalar.u, scalar.u_run, scalar.identifiable)
        rows.append(_cells(name, own, offset, math.nan, *size))
    return rows


def data_frame(result: CalibrationResult) -> Any:
    """The same as a data frame; see ``CalibrationResult.to_frame``."""
    module = _optional('pandas', 'CalibrationResult.to_frame()')
    tables = result.tables
    frame = module.DataFrame(table_cells(result.document), columns=list(COLUMNS))
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
    covariance, covariance_run : ndarray, shape (m, m)
        Of ``Machine.scalars`` and the nodes of ``Machine.motions``, m and rad: all sources, and
        noise and misfit of the run alone.
    covariance_change : ndarray, optional
        The latter with declared contributions; None where none is declared.
    budget : Budget
        All sources, typical values where nothing is declared.
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
    verdicts : Verdicts
        Is the measurement good; is the machine within its limits.
    """

    run_id: str
    tables: ErrorTables
    covariance: Array
    covariance_run: Array
    covariance_change: Array | None
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
    verdicts: Verdicts
    config: CalibrationConfig
    origin: tuple[Origin, ...] = ()
    effects: tuple[StatedEffect, ...] = ()
    effects_sentence: str = ''
    applied: tuple[tuple[AppliedEffect, ...], ...] = ()
    uncorrected: CalibrationResult | None = None

    @property
    def plain(self) -> CalibrationResult:
        """The calibration without effects taken off."""
        return self.uncorrected or self

    @property
    def method(self) -> str:
        """'otf', 'standstill': only the stops at the corners, or 'points': pairs of points."""
        return self.runs[0].pieces.method

    @property
    def needs(self) -> list[str]:
        """What would show the errors that the data do not show, one line for those of one need."""
        by_need: dict[str, list[str]] = {}
        for name, need in self.advice.items():
            by_need.setdefault(need, []).append(name)
        return [f'{", ".join(names)}: needs {need}' for need, names in by_need.items()]

    @property
    def sentence(self) -> str:
        """The outcome."""
        measurement, machine = self.verdicts.measurement, self.verdicts.machine
        if not measurement.good:
            return measurement.sentence
        return '; '.join([*self.headline.sentences[:2], measurement.sentence, machine.sentence])

    @cached_property
    def volume(self) -> VolumetricError:
        """Errors over the volume of the tables, with the uncertainty of the headline."""
        return VolumetricError(self.tables, self.covariance)

    @cached_property
    def offset_bound(self) -> OffsetBound:
        """Values that hold at the target offset of the measurement only."""
        return offset_bound(self.tables.machine, self.not_identifiable)

    @cached_property
    def budget_lines(self) -> list[BudgetLine]:
        """Lines of the budget: everything that is identifiable, and the grid."""
        return budget_lines(self.tables, self.budget, self.not_identifiable)

    @cached_property
    def expanded(self) -> dict[str, Array]:
        """K u of scalars (1,) and nodes (k,), m and rad; zero where not identifiable."""
        factors = {line.name: line.k for line in self.budget_lines}
        u = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        places = table_places(self.tables)
        return {name: factors.get(name, 0.0) * u[place] for name, place in places.items()}

    @cached_property
    def document(self) -> CalibrationDocument:
        """What is written and quoted: the content of error_tables.json."""
        return document_of(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of error_tables.json as plain data."""
        return self.document.to_dict()

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
            (standard uncertainty with everything that is stated), ``u_run`` (noise and misfit of
            the run alone), ``identifiable``, ``k`` (for 95 %), ``target_offset`` (m, at which
            alone a value holds; None if at any): as in error_tables.csv. ``attrs`` hold machine,
            chain, run_id and target_offset.

        Raises
        ------
        ConfigError
            If pandas is not installed.

        Examples
        --------
        >>> frame = result.to_frame()  # doctest: +SKIP
        >>> frame[frame.error == 'EXX'].plot('position', 'value', yerr='u')  # doctest: +SKIP
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

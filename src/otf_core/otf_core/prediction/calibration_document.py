# SPDX-License-Identifier: Apache-2.0
"""error_tables.json: what a calibration states, in memory as in the file.

One class a block. Pages, terminal, certificate, messages and exports take numbers and sentences
from here. ``u`` is the standard uncertainty (k = 1) with everything that is stated; ``u_run``
beside it is that of noise and misfit of the run alone.

Older files: ``otf-error-tables/1`` and files without ``systematic`` mean by ``u`` noise, misfit
and what was declared. It is read as that, stands for ``u_run`` too, and ``remarks`` say so.
"""

from __future__ import annotations

import base64
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from otf_core.arrays import Array
from otf_core.documents import Document, ResultDocument, optional, stated
from otf_core.errors import ConfigError, InputError
from otf_core.files.message_text import shortened
from otf_core.files.strict_yaml import read_json, value_text
from otf_core.model.expanded import micro_significant, micro_unit, micro_with_expanded
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine, machine_from_dict
from otf_core.model.motions import AXES, ErrorMotion, is_motion
from otf_core.model.sections import UNCERTAINTY, VOLUMETRIC
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.prediction.absorbed import OffsetBound
from otf_core.prediction.driven_volume import DrivenVolume

if TYPE_CHECKING:  # Python 3.10 has none
    from typing import Self

SCHEMA, FIRST_SCHEMA = 'otf-error-tables/2', 'otf-error-tables/1'
"""The first one, of three linear axes, is read alone."""
ORTHONORMAL = 1e-4
"""Largest departure of a rotation matrix in a file, which may be rounded."""
DECLARED, TYPICAL = 'declared', 'typical'
PASS: Literal['pass'] = 'pass'
FAIL: Literal['fail'] = 'fail'
OPEN: Literal['not proven'] = 'not proven'
UNKNOWN: Literal['not known'] = 'not known'
NOT_STATED: Literal['not stated'] = 'not stated'
"""State of a machine without limits."""
STATE_WORDS = {PASS: 'kept', FAIL: 'broken', OPEN: 'not proven', UNKNOWN: 'not known'}
MEASUREMENT_FAILED, LIMIT_NOT_PROVEN = 4, 5
"""Exit codes: a quality gate failed; the measurement is good, a limit is not proven to be met."""
LIMIT_MEANING = {
    VOLUMETRIC: 'volumetric error, at the decisive point',
    UNCERTAINTY: 'expanded uncertainty of the volumetric error, largest',
}


@dataclass(frozen=True)
class Fit(Document):
    """Size and quality of a fit."""

    samples: int = stated('samples of all runs', least=0, default=0)
    used: int = stated('samples that were used', least=0, default=0)
    unknowns: int = stated('free unknowns after the gauge', least=0, default=0)
    rank: int = stated('combinations of them that the data determine', least=0, default=0)
    path_mae_before: float = stated(
        'mean distance from the path, rigidly aligned', 'm', least=0.0, default=0.0
    )
    path_mae_after: float = stated('the same, compensated', 'm', least=0.0, default=0.0)
    residual_rms: float = stated(
        'root mean square of the residual across the path', 'm', least=0.0, default=0.0
    )
    outliers: int = stated('samples off their own line, left out', default=0)
    pieces: int = stated('pieces of the path', default=0)
    coverage: float = stated('driven share of the path length', default=1.0)
    residual_ratio: float = stated(
        'residual of the pieces over the noise specified for single samples', default=0.0
    )
    variance_ratio: float = stated('residual variance over the variance assumed', default=1.0)
    correlation_factor: float = stated(
        'correlation of the residuals beyond the one assumed', default=1.0
    )
    inflation: float = stated('factor on the covariance that both call for', default=1.0)
    iterations: int = stated('iterations of the solver', default=0)


@dataclass(frozen=True)
class TargetPlace(Document):
    """Place of a reflector."""

    link: str = stated('w: on the table, t: on the tool side', default='t')
    place: Array = stated('in the frame of its link', 'm', shape=(3,), factory=lambda: np.zeros(3))
    u: Array = stated('its standard uncertainty', 'm', shape=(3,), factory=lambda: np.zeros(3))
    u_run: Array | None = stated(
        'noise and misfit of the run alone', 'm', shape=(3,), default=None
    )


@dataclass(frozen=True)
class DrivenPart(Document):
    """A part of a run between two places of the reflector."""

    target: str = stated('name of the reflector')
    corners: int = stated('corners of its path')
    driven: float = stated('share of its path that was driven')
    moved: tuple[str, ...] = stated('axes that moved the reflector in view of the tracker')


@dataclass(frozen=True)
class RunEntry(Document):
    """One recording."""

    name: str = stated('of the recording')
    target_offset: Array = stated('target offset', 'm', shape=(3,))
    parts: tuple[DrivenPart, ...] = stated('in driving order')
    alignment: RigidTransform = stated('takes tracker to machine coordinates')
    coverage: float = stated('driven share of the path length')
    samples: int = stated('samples')
    pieces: int = stated('pieces of the path')
    residual_rms: float = stated('residual across the path, root mean square', 'm')
    noise: Mapping[str, Any] = stated('noise of single samples, as noise.json')
    misfit: Mapping[str, float] = stated(
        'what the model leaves: of every piece (independent), shared by a line (slow)', 'm'
    )
    standstill: bool = stated('only the stops at the corners')
    duration: float = stated('from the first to the last piece', 's')
    rate: float = stated('usual rate of the samples', 'Hz')
    feed: Array = stated('feed of 5, 50 and 95 % of the path', 'm/s', shape=(3,))
    used: int = stated('samples that were used')
    outliers: int = stated('samples off their own line, left out')
    lost: Mapping[str, float] = stated('samples missing by the stamps, gaps, longest gap (s)')
    remarks: tuple[str, ...] = stated('what was repaired or left out while it was read')
    residual_rms_of: Array = stated('residual of each direction, root mean square', 'm')
    legs: Mapping[str, Any] = stated(
        'time (s) of every leg, distance from the path before and after compensation (m)'
    )
    track: Mapping[str, Any] = stated('where residuals lie: leg, point (m), residual (m)')
    drift: Mapping[str, Any] = stated('mean residual by part: time (s), value, u (m)')


@dataclass(frozen=True)
class ReversalEntry(Document):
    """Reversal of one motion."""

    position: Array = stated('nodes', 'm or rad', shape=('k',))
    value: Array = stated('forward minus backward', 'm or rad', shape=('k',))
    u: Array | None = stated(
        'with everything that is stated',
        'm or rad',
        shape=('k',),
        default=None,
    )
    u_run: Array | None = stated(
        'by noise and misfit of the run alone', 'm or rad', shape=('k',), default=None
    )
    identifiable: bool = stated('false: the data do not show it', default=True)
    forward: Array | None = stated(
        'error towards larger positions', 'm or rad', shape=('k',), default=None
    )
    backward: Array | None = stated(
        'error towards smaller positions', 'm or rad', shape=('k',), default=None
    )
    axis: str = stated('axis that moves', default='')
    unit: str = stated('m or rad', default='')


@dataclass(frozen=True)
class SizeEntry(Document):
    """A value and its standard uncertainty."""

    value: float = stated('value')
    u: float = stated('its standard uncertainty with everything that is stated')
    u_run: float | None = stated('by noise and misfit of the run alone', default=None)


@dataclass(frozen=True)
class ReversalBlock(Document):
    """How motions differ between forward and backward travel."""

    motions: Mapping[str, ReversalEntry] = stated('of the motions that differ', factory=dict)
    model: str = stated('none, constant or tables', default='none')
    evidence: Mapping[str, Any] = stated('why this model', factory=dict)
    held: bool = stated('axes that stand stay on the side of their last travel', default=False)
    sign: str = stated(
        'what the values mean',
        default='value = forward minus backward; forward: towards larger positions',
    )
    axes: Mapping[str, SizeEntry] = stated(
        'reversal value of an axis at the target', 'm', factory=dict
    )
    lags: Mapping[str, SizeEntry] = stated(
        'time by which an axis is late behind the others', 's', factory=dict
    )


@dataclass(frozen=True)
class StatedEffect(Document):
    """An effect that was taken off the data."""

    effect: str = stated('name in the catalogue')
    parameters: Mapping[str, float] = stated('by name', 'SI')
    u: Mapping[str, float] = stated('of those that were estimated', 'SI')
    units: Mapping[str, str] = stated('unit of every parameter')
    how: Literal['found', 'file'] = stated('found by a diagnosis, or given in a file')


@dataclass(frozen=True)
class PackedCovariance(Document):
    """Covariance of scalars and nodes, exact to the last bit."""

    size: int = stated('rows')
    data: str = stated('the lower triangle')
    order: str = stated('what the rows are', default='')
    packing: str = stated(
        'how it is packed', default='lower triangle by rows, little-endian float64, base64'
    )

    @classmethod
    def of(cls, covariance: Array, machine: Machine) -> PackedCovariance:
        """Pack a covariance (m, m)."""
        lower = covariance[np.tril_indices(len(covariance))].astype('<f8')
        order = f'{", ".join(machine.scalars)}, then the nodes of {", ".join(machine.motions)}'
        return cls(len(covariance), base64.b64encode(lower.tobytes()).decode('ascii'), order)

    def unpack(self, size: int) -> Array | None:
        """Return it, shape (size, size); None if it is of another size as nodes were edited."""
        if self.size != size:
            return None
        try:
            lower = np.frombuffer(base64.b64decode(self.data, validate=True), '<f8')
            covariance = np.zeros((size, size))
            covariance[np.tril_indices(size)] = lower
        except ValueError:
            return None
        return covariance + np.tril(covariance, -1).T


@dataclass(frozen=True)
class BudgetEntry(Document):
    """One quantity of the budget."""

    unit: str = stated('m or rad')
    u: float = stated('standard uncertainty, root mean square over nodes or grid', 'm or rad')
    sources: Mapping[str, float] = stated('the same by source; squares add up', 'm or rad')
    k: float = stated('coverage factor for 95 %')
    dof: float | None = stated('effective degrees of freedom; null: infinite')


@dataclass(frozen=True)
class BudgetBlock(Document):
    """Uncertainty by source."""

    coverage_probability: float = stated('of k')
    dof: Mapping[str, int | None] = stated('degrees of freedom by source; null: infinite')
    not_stated: tuple[str, ...] = stated('contributions that machine.yaml does not declare')
    u_rms: Mapping[str, BudgetEntry] = stated('by motion, scalar, and grid: the error vector')


@dataclass(frozen=True)
class Correlation(Document):
    """Strongest correlation between two tables: where, and the coefficient."""

    between: tuple[str, str] = stated('motions with position, or scalars')
    r: float = stated('coefficient')


@dataclass(frozen=True)
class CorrelationBlock(Document):
    """Correlations between tables."""

    at_least: float = stated('coefficient from which they are listed')
    strongest: tuple[Correlation, ...] = stated('strongest first')
    more: int = stated('that are not listed')


@dataclass(frozen=True)
class TypicalBlock(Document):
    """Systematic contributions that nobody declared."""

    missing: tuple[str, ...] = stated('contributions, as the budget calls them')
    presets: tuple[str, ...] = stated('presets that typical values come from')
    assumed: Mapping[str, float] = stated(
        'typical standard uncertainty of every key that is missing', 'SI'
    )
    sentence: str = stated('the same, and what to do')


@dataclass(frozen=True)
class Remainder(Document):
    """Uncertainty of the error vectors over the volume: what compensation will leave."""

    u: Mapping[str, float] = stated('mean, p95 and max of the standard uncertainty', 'm')
    u_run: Mapping[str, float] = stated('the same of noise and misfit alone', 'm')
    k: float = stated('coverage factor for 95 %')
    systematic: Literal['declared', 'typical'] = stated(
        'where systematic contributions come from; typical: at least one is'
    )
    typical_for: tuple[str, ...] = stated('contributions that are typical ones')
    label: str = stated('the same in words')

    @property
    def expanded(self) -> dict[str, float]:
        """K times ``u``, m."""
        return {name: self.k * size for name, size in self.u.items()}

    @property
    def observed(self) -> dict[str, float]:
        """K times ``u_run``, m."""
        return {name: self.k * size for name, size in self.u_run.items()}

    @property
    def expanded_words(self) -> str:
        """What is to be expected after compensation."""
        return (
            f'expected after compensation: {_sizes(self.expanded)} '
            f'(U, k = {self.k:.3g}; {self.label})'
        )

    @property
    def forecast_words(self) -> str:
        """The same before anything is measured."""
        return f'noise of the tracker alone: {self.observed_words}'

    @property
    def observed_words(self) -> str:
        """The part that holds nothing systematic."""
        return f'{_sizes(self.observed)} (U)'


def _sizes(sizes: Mapping[str, float]) -> str:
    pairs = (('mean', 'mean'), ('largest', 'max'))
    return ', '.join(f'{word} {micro_significant(sizes[name])}' for word, name in pairs)


def systematic_fields(assumed: tuple[str, ...], nothing_declared: bool) -> dict[str, Any]:
    """``systematic``, ``typical_for`` and ``label`` of a ``Remainder``."""
    label = 'systematic contributions as declared'
    if assumed:
        label = (
            'systematic contributions typical, not declared in machine.yaml'
            if nothing_declared
            else f'{label}; {", ".join(assumed)} typical, not declared'
        )
    kind = TYPICAL if assumed else DECLARED
    return {'systematic': kind, 'typical_for': assumed, 'label': label}


@dataclass(frozen=True)
class Headline(Remainder):
    """Volumetric error and its uncertainty on one grid, best rigid motion removed."""

    points: int = stated('of the grid over the driven volume')
    error: Mapping[str, float] = stated('mean, p95 and max length of the errors as found', 'm')
    u_of_largest: float = stated('standard uncertainty of the largest length', 'm')
    sentences: tuple[str, ...] = stated('error, what compensation leaves, noise and misfit alone')


@dataclass(frozen=True)
class LimitVerdict(Document):
    """One limit of machine.yaml and what is known of it."""

    name: str = stated('key of limits')
    unit: str = stated('m or rad')
    limit: float = stated('as stated', 'm or rad')
    value: float = stated('what was found', 'm or rad')
    u: float = stated('standard uncertainty of the value; 0 of an uncertainty', 'm or rad')
    k: float = stated('coverage factor for 95 %')
    state: Literal['pass', 'fail', 'not proven', 'not known'] = stated(
        'pass: value + k u is within the limit; fail: value - k u is beyond it'
    )

    @property
    def U(self) -> float:
        """Expanded uncertainty of the value, 95 %."""
        return self.k * self.u

    @property
    def words(self) -> str:
        """One line."""
        limit = f'limit {1e6 * self.limit:g} {micro_unit(self.unit)}: {STATE_WORDS[self.state]}'
        what = LIMIT_MEANING.get(self.name, self.name)
        if self.state == UNKNOWN:
            return f'{what}: the data do not show it, {limit}'
        if not self.U:
            return f'{what} {micro_significant(self.value, self.unit)}, {limit}'
        return f'{what} {micro_with_expanded(self.value, self.U, self.unit)}, {limit}'


@dataclass(frozen=True)
class MeasurementVerdict(Document):
    """Whether the measurement is good."""

    good: bool = stated('no quality gate failed')
    failed: tuple[str, ...] = stated('quality gates that failed')
    sentence: str = stated('the verdict')


@dataclass(frozen=True)
class MachineVerdict(Document):
    """Whether the machine is within its limits."""

    state: Literal['pass', 'fail', 'not proven', 'not known', 'not stated'] = stated(
        'worst of all limits'
    )
    sentence: str = stated('the verdict')
    limits: tuple[LimitVerdict, ...] = stated('every limit', default=())
    rule: str = stated(
        'rule of decision',
        default='pass: value + k u <= limit; fail: value - k u > limit (ISO 14253-1)',
    )


@dataclass(frozen=True)
class Verdicts(Document):
    """The two verdicts of a calibration, which never mix."""

    measurement: MeasurementVerdict = stated('by the quality gates')
    machine: MachineVerdict = stated('by the limits of machine.yaml')

    @property
    def exit_code(self) -> int:
        """0, 4 if the measurement is not good, 5 if it is and a limit is not proven to be met."""
        if not self.measurement.good:
            return MEASUREMENT_FAILED
        return 0 if self.machine.state in (PASS, NOT_STATED) else LIMIT_NOT_PROVEN

    @property
    def words(self) -> tuple[str, ...]:
        """Both, and a line for each limit that is not proven to be kept."""
        lines = (f'  {one.words}' for one in self.machine.limits if one.state != PASS)
        return (self.measurement.sentence, self.machine.sentence, *lines)


@dataclass(frozen=True)
class SpacingCost(Document):
    """What straight lines between nodes cost."""

    fraction: int = stated('nodes stand table_pitch / fraction apart')
    grid: float = stated('mean length of the difference on a grid', 'm')
    motions: Mapping[str, float] = stated('root mean square of a motion', 'm or rad')


@dataclass(frozen=True)
class SpacingBlock(Document):
    """Spacing of the nodes."""

    table_pitch_over: int = stated('nodes stand table_pitch / this apart')
    cost: tuple[SpacingCost, ...] = stated('for 1, the wish, and the fraction taken')


@dataclass(frozen=True)
class PriorEntry(Document):
    """What a rotation that was not seen may be."""

    sd: float = stated('standard deviation', 'rad', least=0.0, default=0.0)


@dataclass(frozen=True)
class CalibrationDocument(ResultDocument):
    """Everything that a calibration states; the content of error_tables.json."""

    file = 'error_tables.json'

    machine: Machine = stated('machine.yaml')
    motions: Mapping[str, MotionTable] = stated('error motions of all axes (ISO 230-1)')
    squareness: Mapping[str, ScalarError] = stated('squareness errors', 'rad', factory=dict)
    location: Mapping[str, ScalarError] = stated(
        'location errors of rotary axes', 'm or rad', factory=dict
    )
    schema: str = stated('otf-error-tables/2', default=SCHEMA)
    systematic: Literal['declared', 'typical', 'unknown'] = stated(
        'systematic contributions in u: declared, or typical where machine.yaml declares none',
        default='unknown',
    )
    targets: Mapping[str, TargetPlace] = stated(
        'reflectors whose places were sought', factory=dict
    )
    alignment: RigidTransform | None = optional('takes tracker to machine coordinates, first run')
    tracker_link: str = stated('on what the tracker stands', default='w')
    headline: Headline | None = optional('what is stated first')
    verdicts: Verdicts | None = optional('measurement and machine')
    not_identifiable: tuple[str, ...] = stated('errors that the data do not show', default=())
    warnings: tuple[str, ...] = stated('what the user should read', default=())
    failed_gates: tuple[str, ...] = stated('quality gates that failed', default=())
    effects: tuple[StatedEffect, ...] = stated('taken off before the solution', default=())
    effects_sentence: str = stated('effects found and removed; may be empty', default='')
    fit: Fit | None = optional('size and quality of the fit')
    reversal: ReversalBlock | None = optional('of forward and backward travel')
    runs: tuple[RunEntry, ...] = stated('one a recording', default=())
    run_id: str = stated('hash of samples, paths, machine and configuration', default='')
    gauge: str = stated('what is zero by definition', default='')
    spacing: SpacingBlock | None = optional('of the nodes')
    prior: Mapping[str, PriorEntry] = stated(
        'of rotations that were not seen: they count for another tool', factory=dict
    )
    target_offset_bound: OffsetBound | None = optional(
        'values that hold at one target offset only'
    )
    driven: DrivenVolume | None = optional('hull of what was driven')
    budget: BudgetBlock | None = optional('uncertainty by source')
    correlations: CorrelationBlock | None = optional('between tables')
    typical_systematic: TypicalBlock | None = stated(
        'typical contributions; null if all are declared', default=None
    )
    covariance: PackedCovariance | None = optional('of u')
    covariance_run: PackedCovariance | None = optional('of u_run')
    covariance_change: PackedCovariance | None = optional(
        'what a change is judged by: u_run and declared contributions, which do not repeat; as '
        'covariance_run where none is declared'
    )
    config: Mapping[str, Any] = stated('parameters of the calibration', factory=dict)
    provenance: Mapping[str, Any] = stated('when, from what, by what', factory=dict)
    volumetric_error: Mapping[str, Any] | None = optional(
        'error vectors over the volume: position, error, u, u_run (m); what each error makes alone'
    )
    sizes: Mapping[str, Mapping[str, Any]] | None = optional(
        'span of every motion and size of every scalar with u and k; null: not known'
    )
    coverage: Mapping[str, Any] | None = optional('samples along every axis and around its nodes')
    diagonals: tuple[Mapping[str, Any], ...] = stated(
        'diagonals as the tables predict them, in the manner of ISO 230-6 (m)', default=()
    )
    turns: Mapping[str, Any] | None = stated(
        'mean length of the error vector over the rotary axes', default=None
    )
    imported: Mapping[str, float] | None = optional('what the tables leave of a lattice')
    remarks: tuple[str, ...] = ()
    without_u: tuple[str, ...] = ()

    @property
    def tables(self) -> ErrorTables:
        """Machine, motions and scalars."""
        return ErrorTables(self.machine, self.motions, self.squareness, self.location)

    @property
    def exit_code(self) -> int:
        """0, 4 or 5, see ``Verdicts``."""
        return 0 if self.verdicts is None else self.verdicts.exit_code

    @classmethod
    def of_tables(cls, tables: ErrorTables, **more: Any) -> CalibrationDocument:
        """Document of tables alone, or with more blocks."""
        own = (tables.machine, named_tables(tables), tables.squareness, tables.location)
        return cls(*own, **more)

    @classmethod
    def from_dict(cls, data: Any, where: str = '') -> Self:
        """Read the layout of error_tables.json, also of other people's files.

        ``u``, ``identifiable``, squareness, location, alignment and fit may be missing.

        Raises
        ------
        InputError
            Names the motion and what is wrong with it.
        """
        if not isinstance(data, Mapping) or data.get('schema') not in (SCHEMA, FIRST_SCHEMA):
            raise InputError(f"{where}: not error tables; expected schema '{SCHEMA}'")
        machine = machine_from_dict(data.get('machine'), f'{where}: machine')
        if data['schema'] == FIRST_SCHEMA and machine.axis_names != AXES:
            raise InputError(f"{where}: schema: must be '{SCHEMA}' for the chain {machine.chain}")
        old = 'systematic' not in data
        # blocks of older files that meant something else are not read
        content = {k: v for k, v in data.items() if v is not None and not (old and k in CHANGED)}
        _check_alignment(content, where)
        motions = _named(content, 'motions', machine.motions, where)
        missing = [name for name in machine.motions if name not in motions]
        if missing:
            raise InputError(f'{where}: motions: {missing[0] if motions else "all"} missing')
        content['motions'] = {n: motions[n] for n in machine.motions}
        silent: list[str] = []
        for kind, names in (('squareness', machine.squareness), ('location', machine.location)):
            given = _named(content, kind, names, where)
            content[kind] = {n: {} if given.get(n) is None else given[n] for n in names}
            entries = {n: own for n, own in content[kind].items() if isinstance(own, Mapping)}
            silent += [n for n, own in entries.items() if 'value' not in own]
        if isinstance(prior := content.get('prior'), Mapping):
            content['prior'] = {n: v for n, v in prior.items() if is_motion(n)}
        document = super().from_dict(content, where)
        tables = document.tables
        for name in machine.motions:
            _check_motion(tables.motions[name], name, machine, f'{where}: motions: {name}')
        reversal = content.get('reversal') if document.reversal else {}
        place = f'{where}: reversal'
        for reversed_, own in _named(reversal or {}, 'motions', machine.motions, place).items():
            value = np.asarray(own['value'])
            table = MotionTable(np.asarray(own['position']), value, value)
            motion = ErrorMotion.of(reversed_)
            _check_motion(table, motion, machine, f'{place}: motions: {motion}')
        entries = {**content['squareness'], **content['location'], **content['motions']}
        without = [n for n, v in entries.items() if n not in silent and 'u' not in v]
        remarks = []
        if silent:
            remarks.append(f'the tables do not contain {", ".join(silent)}: taken as zero')
        if old and len(without) + len(silent) < len(entries):
            remarks.append(
                'older file: u holds noise, misfit and what was declared of systematic '
                'contributions, no typical ones; it states no u_run, so u stands for it'
            )
        return replace(
            document,
            machine=machine,
            motions={ErrorMotion.of(n): v.with_defaults() for n, v in document.motions.items()},
            squareness={n: v.with_defaults() for n, v in document.squareness.items()},
            location={n: v.with_defaults() for n, v in document.location.items()},
            remarks=tuple(remarks),
            without_u=tuple(without),
        )


CHANGED = ('headline', 'verdicts', 'budget', 'correlations', 'typical_systematic', 'spacing',
           'runs', 'effects', 'config')  # fmt: skip
"""Blocks that mean something else in older files, or have other fields."""


def named_tables(tables: ErrorTables) -> dict[str, MotionTable]:
    """Motions with axis and units, in the order of the machine."""
    axes, motions = tables.machine.axes, tables.machine.motions
    return {
        m: replace(tables.motions[m], axis=m.axis, unit=m.unit, position_unit=axes[m.axis].unit)
        for m in motions
    }


def _named(
    data: Mapping[str, Any], key: str, names: Collection[str], where: str
) -> Mapping[str, Any]:
    """Mapping under a key, empty where there is none; its keys are all among ``names``."""
    mapping = data.get(key) or {}
    if not isinstance(mapping, Mapping):
        raise InputError(f'{where}: {key}: expected a mapping, got {value_text(mapping)}')
    unknown = sorted(set(mapping) - set(names))
    if unknown:
        raise InputError(
            f'{where}: {key}: {shortened(unknown[0])}: unknown; known for this chain: '
            f'{", ".join(names) or "none"}'
        )
    return mapping


def _check_motion(table: MotionTable, name: ErrorMotion, machine: Machine, where: str) -> None:
    """Refuse a table of another axis or unit, or whose nodes are none."""
    along = machine.axes[name.axis].unit
    for key, right in (('unit', name.unit), ('axis', name.axis), ('position_unit', along)):
        if getattr(table, key) not in ('', right):
            raise InputError(f"{where}: {key}: must be '{right}', got {getattr(table, key)!r}")
    size = len(table.position)
    if not size or np.any(np.diff(table.position) <= 0):
        raise InputError(f'{where}: position: must be a list that ascends strictly')
    for key in ('value', 'u', 'u_run', 'node_identifiable'):
        own = getattr(table, key)
        if own is not None and len(own) != size:
            raise InputError(f'{where}: {key}: has length {len(own)}, expected {size}')


def _check_alignment(data: dict[str, Any], where: str) -> None:
    """Refuse an alignment that is no rotation with a translation; either may be missing."""
    given = data.get('alignment')
    if not isinstance(given, Mapping):
        return
    whole = {'rotation': np.eye(3).tolist(), 'translation': [0.0] * 3, **given}
    turn = RigidTransform.from_dict(whole, f'{where}: alignment').rotation
    if np.abs(turn @ turn.T - np.eye(3)).max() > ORTHONORMAL or np.linalg.det(turn) < 0:
        raise InputError(f'{where}: alignment: rotation: not a rotation matrix')
    data['alignment'] = whole


def tables_to_dict(tables: ErrorTables) -> dict[str, Any]:
    """Return tables alone in the layout of error_tables.json."""
    return CalibrationDocument.of_tables(tables).to_dict()


def tables_from_dict(data: Any, where: str) -> CalibrationDocument:
    """Read the layout of error_tables.json; ConfigError says what is wrong and where."""
    try:
        return CalibrationDocument.from_dict(data, where)
    except InputError as error:  # a file that an option names
        raise ConfigError(str(error)) from None


def load_tables(path: str | Path) -> CalibrationDocument:
    """Read an error_tables.json.

    Raises
    ------
    ConfigError
        Says what is wrong and where.

    Examples
    --------
    >>> content = otf_core.load_tables('bags/y-carries-the-table/truth.json')
    >>> content.tables.squareness['C0Y'].value == 0
    False
    """
    return tables_from_dict(read_json(path), str(path))

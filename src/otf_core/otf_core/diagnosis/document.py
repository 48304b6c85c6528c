# SPDX-License-Identifier: Apache-2.0
"""gap.json: what a diagnosis states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from otf_core.calibration.document import driven_run
from otf_core.diagnosis.answer import measured_run
from otf_core.diagnosis.corrected_calibration import in_reversal_tables
from otf_core.diagnosis.place.views import gap_views
from otf_core.diagnosis.result import AnyCause, Diagnosis, Gap, NamedCause
from otf_core.documents import Document, ResultDocument, stated
from otf_core.effects import EVERY, BelongsTo
from otf_core.model.machine import Machine
from otf_core.model.provenance import STANDARD, provenance
from otf_core.pieces.finding import GATE, Finding


@dataclass(frozen=True)
class Unexplained(Document):
    """What stays unexplained."""

    rms_um: float = stated('root mean square', 'um')
    where: str = stated('its structure in words')


@dataclass(frozen=True)
class NotVisible(Document):
    """An effect that leaves no trace in these data."""

    effect: str = stated('name in the catalogue')
    needs: str = stated('what would show it')


@dataclass(frozen=True)
class Rival(Document):
    """An effect in the last round of the search."""

    effect: str = stated('name in the catalogue')
    log_odds: float = stated('that it is the cause')


@dataclass(frozen=True)
class GapDocument(ResultDocument):
    """Where and why a run departs from its simulation."""

    file = 'gap.json'

    runs: tuple[str, ...] = stated('names of the recordings')
    measured: tuple[Mapping[str, Any], ...] = stated('of every run: tracker_place, path, feed')
    verdict: str = stated('none, explained, partly_explained or unknown')
    sentence: str = stated('the verdict in words')
    gap: Gap = stated('size of the gap')
    causes: tuple[NamedCause, ...] = stated('first the one that shrinks the gap most')
    unnamed: Mapping[str, Any] | None = stated(
        'cause without a name: depends_on, acts_as, words, before_um, after_um, '
        'shrink_interval_percent, curves'
    )
    unexplained: Unexplained = stated('what is left')
    not_visible: tuple[NotVisible, ...] = stated('neither found nor absent')
    where: Mapping[str, Any] = stated(
        'where the gap lies: summary, view, parts, separation, components_um, by_time, '
        'by_axis_and_direction, by_path_piece, by_region, by_beam, by_frequency'
    )
    considered: tuple[Rival, ...] = stated('ranking of the last round')
    table_change_um: float = stated('mean change of predictions by taking the causes off', 'um')
    smallest_found_um: Mapping[str, float] = stated(
        'root mean square displacement from which an effect would be found', 'um', unknown=True
    )
    contradictions: tuple[Finding, ...] = stated('what the input contradicts')
    reversal: str = stated('model of reversal of the calibration')
    reversal_holds: tuple[str, ...] = stated('causes that its reversal tables contain as well')
    machine: Machine = stated('machine.yaml')
    conditions: Mapping[str, str] = stated('of the runs, in words')
    calibration_runs: tuple[Mapping[str, Any], ...] = stated('as runs of error_tables.json')
    views: Mapping[str, Any] = stated('residuals by time, place, travel, beam, frequency (um)')
    run_id: str = stated('hash of samples, paths, machine and configuration')
    any_cause: AnyCause | None = stated(
        'whether anything is missing, before any name is given', default=None, sparse=True
    )
    schema: str = stated('otf-gap/1', default='otf-gap/1')
    provenance: Mapping[str, Any] = stated('when, from what, by what', factory=dict)

    @property
    def exit_code(self) -> int:
        """0, or 4 if the input contradicts itself."""
        return 4 if any(one.severity == GATE for one in self.contradictions) else 0


def document_of(diagnosis: Diagnosis) -> GapDocument:
    """Return what a diagnosis states."""
    shown, plain, where = diagnosis.shown, diagnosis.calibration.plain, diagnosis.where
    held = (_held_words(diagnosis, cause) for cause in diagnosis.causes)
    return GapDocument(
        runs=diagnosis.runs,
        measured=tuple(map(measured_run, shown.views)),
        verdict=diagnosis.verdict,
        sentence=diagnosis.sentence,
        gap=diagnosis.gap,
        any_cause=diagnosis.any_cause,
        causes=diagnosis.causes,
        unnamed=None if diagnosis.unnamed is None else asdict(diagnosis.unnamed),
        unexplained=Unexplained(diagnosis.unexplained_um, diagnosis.unexplained_where),
        not_visible=tuple(NotVisible(*one) for one in diagnosis.not_visible),
        where=asdict(where),
        considered=tuple(Rival(*one) for one in diagnosis.considered),
        table_change_um=diagnosis.table_change_um,
        smallest_found_um=dict(diagnosis.smallest_found_um),
        contradictions=diagnosis.contradictions,
        reversal=diagnosis.reversal.model,
        reversal_holds=tuple(filter(None, held)),
        machine=diagnosis.machine,
        conditions=dict(shown.conditions),
        calibration_runs=tuple(map(driven_run, plain.runs)),
        views=gap_views(shown.views, bool(diagnosis.causes), where.grouping or ''),
        run_id=plain.run_id,
        provenance=provenance(
            'diagnose', method='otf', runs=diagnosis.origin,
            coverage=f'{STANDARD}; intervals: 95 %',
        ),
    )  # fmt: skip


def _held_words(diagnosis: Diagnosis, cause: NamedCause) -> str:
    """What the reversal tables of the calibration hold of a cause; empty of any other."""
    known = EVERY.get(cause.effect)
    if known is None or known.belongs_to is not BelongsTo.REVERSAL:
        return ''
    held = in_reversal_tables(diagnosis.reversal, cause.axes)
    name = cause.effect.replace('_', ' ')
    return f'The reversal tables of the calibration contain {name} as well{held}.' if held else ''

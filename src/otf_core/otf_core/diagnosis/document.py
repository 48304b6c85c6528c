# SPDX-License-Identifier: Apache-2.0
"""gap.json: what a diagnosis states."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from otf_core.calibration.document import driven_run
from otf_core.diagnosis.answer import measured_run
from otf_core.diagnosis.corrected_calibration import in_reversal_tables
from otf_core.diagnosis.place.views import gap_views
from otf_core.diagnosis.result import AnyCause, Diagnosis, Gap, NamedCause
from otf_core.documents import Document, ResultDocument, optional, stated
from otf_core.effects import EVERY, BelongsTo
from otf_core.files.message_text import join_names
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
    search: tuple[str, ...] = stated('what was looked for, where no cause is named', default=())
    measure_next: tuple[str, ...] = stated('what to measure next, most useful first', default=())
    any_cause: AnyCause | None = optional('whether anything is missing, before any name is given')
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
    document = GapDocument(
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
    search, wishes = describe_search(document), next_measurements(document)
    return replace(document, search=tuple(search), measure_next=tuple(wishes))


def _held_words(diagnosis: Diagnosis, cause: NamedCause) -> str:
    """What the reversal tables of the calibration hold of a cause; empty of any other."""
    known = EVERY.get(cause.effect)
    if known is None or known.belongs_to is not BelongsTo.REVERSAL:
        return ''
    held = in_reversal_tables(diagnosis.reversal, cause.axes)
    name = cause.effect.replace('_', ' ')
    return f'The reversal tables of the calibration contain {name} as well{held}.' if held else ''


def _name(effect: str) -> str:
    return effect.replace('_', ' ')


def _needed_for(effect: str) -> str:
    known = EVERY.get(effect)
    return known.words.shown_by if known else ''


def next_measurements(document: GapDocument) -> list[str]:
    """What to measure next, plain text, most useful first."""
    wishes: list[tuple[str, str]] = []
    for cause in document.causes:
        rivals = cause.indistinguishable_from
        if rivals:
            others = ' or '.join(r.replace('_', ' ') for r in rivals)
            reason = f'to distinguish {_name(cause.effect)} from {others}'
            wishes += [
                (n, reason) for n in dict.fromkeys(map(_needed_for, (cause.effect, *rivals))) if n
            ]
    if document.verdict in ('unknown', 'partly_explained'):
        wishes.append(
            (
                'the same path once more, also backwards and at a second feed, and from a second '
                'tracker place',
                'to see whether the unexplained part depends on time, travel or tracker',
            )
        )
    hidden = {_name(one.effect): one.needs for one in document.not_visible}
    wishes += [(need, name) for name, need in hidden.items()]
    return _merged_wishes(wishes, set(hidden))


def _merged_wishes(wishes: Iterable[tuple[str, str]], hidden: set[str]) -> list[str]:
    """One line for wishes that begin alike: what is wanted, details, what for."""
    grouped: dict[str, tuple[list[str], list[str]]] = {}
    for wish, reason in wishes:
        head, *rest = re.split(r'[,;:] ', wish, maxsplit=1)
        details, reasons = grouped.setdefault(head, ([], []))
        details += [r for r in rest if r not in details]
        reasons.append(reason)
    lines = []
    for head, (details, reasons) in grouped.items():
        own = [r for r in reasons if r not in hidden]
        unseen = [r for r in reasons if r in hidden]
        if unseen:
            own.append('to see ' + join_names(unseen))
        detail = f' ({"; ".join(details)})' if details else ''
        lines.append(f'{head[:1].upper()}{head[1:]}{detail}: {"; ".join(dict.fromkeys(own))}.')
    return lines


def describe_search(document: GapDocument) -> list[str]:
    """What was looked for and how small an effect would have been seen; nothing of a cause."""
    if document.causes:
        return []
    hidden = [one.effect for one in document.not_visible]
    seen = {
        effect: size for effect, size in document.smallest_found_um.items() if effect not in hidden
    }
    if not seen:
        return []
    order = sorted(seen, key=seen.__getitem__)
    least, most = order[0], order[-1]
    sizes = [f'{seen[name]:.2f} um ({_name(name)})' for name in (least, most)]
    words = [
        f'Considered: {len(seen) + len(hidden)} effects. {len(seen)} of them would have been '
        f'detected from a root mean square displacement of'
        f' {sizes[0]} to {sizes[1]} on.'
    ]
    if hidden:
        names = join_names(map(_name, hidden))
        words.append(f'Not visible in these data, whatever their size: {names}.')
    return words

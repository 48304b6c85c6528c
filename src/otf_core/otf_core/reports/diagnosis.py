# SPDX-License-Identifier: Apache-2.0
"""What ``otf diagnose`` writes: gap.json with page and text from it, and corrected tables."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from otf_core.aside import share_out
from otf_core.diagnosis.cause_parameters import CauseSize
from otf_core.diagnosis.result import Diagnosis
from otf_core.effects import EVERY
from otf_core.effects.effects_yaml import write_effects
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.expanded import COVERAGE_FACTOR, quantity
from otf_core.model.machine import machine_from_dict
from otf_core.reports import gap_charts as charts
from otf_core.reports.calibration import write_calibration
from otf_core.reports.calibration_measurement import stated_tables
from otf_core.reports.rendering import State, render
from otf_core.threads import limit_to_one_thread

REPORT_FILE, BESIDE_TABLES = 'report.html', 'gap_report.html'
"""Name of the report; beside error_tables.json there is one of the calibration already."""
CONFIDENCE_WORDS = (
    (0.99, 'practically certain'),
    (0.95, 'very likely'),
    (0.8, 'likely'),
    (0.5, 'more likely than not'),
    (0.0, 'doubtful'),
)
CAUSES = {name: effect.words.cause for name, effect in EVERY.items()}
SHOWN_PARAMETERS, DRAWN_CURVES = 8, 6
"""Of longer lists the most significant parameters are shown, and the largest curves."""
VERDICTS = {
    'none': State('no gap', 'good'),
    'explained': State('explained', 'good'),
    'partly_explained': State('partly explained', 'open'),
    'unknown': State('cause unknown', 'bad'),
}


def effect_name(effect: str) -> str:
    """Name of an effect in words."""
    return effect.replace('_', ' ')


def confidence_words(confidence: float) -> str:
    """Confidence in words and as a number."""
    word = next(word for least, word in CONFIDENCE_WORDS if confidence >= least)
    number = '>\u00a099.9\u00a0%' if confidence > 0.999 else f'{100 * confidence:.3g}\u00a0%'
    return f'{word} ({number})'


def shown_parameters(cause: Mapping[str, Any]) -> tuple[list[str], int, int]:
    """Estimated parameters worth showing; how many more are significant, and how many are not.

    Significant is what is larger than its expanded uncertainty.
    """

    def strength(name: str) -> float:
        u = cause['u'][name]
        return abs(cause['parameters'][name]) / u if u > 0 else math.inf

    estimated = [n for n in cause['parameters'] if n in cause['u']]
    significant = [n for n in estimated if strength(n) > COVERAGE_FACTOR]
    strongest = set(sorted(significant, key=strength, reverse=True)[:SHOWN_PARAMETERS])
    shown = [n for n in significant if n in strongest]
    return shown, len(significant) - len(shown), len(estimated) - len(significant)


def left_out_words(more: int, weak: int) -> list[str]:
    """What is not listed of the parameters of a cause."""
    words = [f'{more} more significant ones in gap.json'] if more else []
    if weak:
        verb = 'is' if weak == 1 else 'are'
        words.append(f'{weak} further {verb} not significant (|value| < U), in gap.json')
    return words


def shape_words(cause: Mapping[str, Any]) -> str:
    """Parameters that were chosen, not estimated; empty if there are none."""
    chosen = [
        f'{name} {quantity(value, None, cause["units"].get(name, ""))}'
        for name, value in cause['parameters'].items()
        if name not in cause['u']
    ]
    return f'chosen: {", ".join(chosen)}' if chosen else ''


def cause_row(rank: int, cause: Mapping[str, Any]) -> tuple[Any, ...]:
    """Rank, name, axes, parameters with U, gap, confidence."""
    about = CAUSES.get(cause['effect'], '')
    rivals = ' or '.join(effect_name(r) for r in cause['indistinguishable_from'])
    named = [effect_name(cause['effect']), *([about] if about else [])]
    sure = [confidence_words(cause['confidence'])]
    if cause['departs']:
        named.append(f'Departs from the formula: {cause["departs"]}')
    if rivals:
        named.append(f'In these data indistinguishable from {rivals}')
        sure.append('that it is one of these')
    parameters, others = parameter_words(cause)
    parameters = [
        p.replace(' =', '').replace('+/-', '±').replace(' ', '\u00a0') for p in parameters
    ]
    return (
        str(rank), named, ', '.join(cause['axes']) or '–',
        ['', *parameters, *others],
        [f'{cause["before_um"]:.2f} → {cause["after_um"]:.2f}',
         f'shrinks by {cause["shrink_percent"]:.0f} %'],
        sure if rivals else sure[0],
    )  # fmt: skip


def parameter_words(cause: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Parameters worth showing with U, and what is said of the others."""
    names, more, weak = shown_parameters(cause)
    units = cause['units']
    shown = [
        f'{n} = {quantity(cause["parameters"][n], cause["u"][n], units.get(n, ""))}' for n in names
    ]
    return shown, [*left_out_words(more, weak), *filter(None, [shape_words(cause)])]


def _size_tile(cause: Mapping[str, Any]) -> tuple[str, str, str]:
    """What a cause is called, its largest size, and what kind of size it is."""
    first, *others = (CauseSize.from_dict(size) for size in cause['sizes'])
    more = [f'{s.of} {s.words}'.strip() for s in others]
    remark = [first.remark, 'U, k = 2' if first.u is not None else '', *more]
    name = f'{effect_name(cause["effect"])} {first.of}'.strip()
    return name[:1].upper() + name[1:], first.words, '; '.join(filter(None, remark))


def _content(doc: Mapping[str, Any]) -> dict[str, Any]:
    return {
        'd': doc,
        'parameters': [parameter_words(cause) for cause in doc['causes']],
    }


def gap_pages(doc: Mapping[str, Any]) -> dict[str, str]:
    """Return the page of a gap.json."""
    curves = [(effect_name(c['effect']), c['departs'], c['curves']) for c in doc['causes']
              if c['curves']]  # fmt: skip
    unnamed = doc['unnamed']
    if unnamed is not None:
        curves.append(('Cause without a name', '', unnamed['curves']))
    measured = doc['provenance'].get('measured') or {}
    when = [m[:19] for m in (measured.get('first'), measured.get('last')) if m]
    page = render(
        'diagnosis.html.j2',
        charts=charts,
        badges=[VERDICTS[doc['verdict']]],
        sized=[_size_tile(c) for c in doc['causes'][:2] if c['sizes']],
        measured=' to '.join(f'{m}Z' for m in when),
        rows=[cause_row(k, c) for k, c in enumerate(doc['causes'], start=1)],
        meanings=[(effect_name(e), EVERY[e].words.displacement, EVERY[e].words.parameters) for e in
                  dict.fromkeys(c['effect'] for c in doc['causes']) if e in EVERY],
        curves=[(name, said, [charts.curve_chart(c) for c in own[:DRAWN_CURVES]])
                for name, said, own in curves],
        causes_of=CAUSES,
        stated=stated_tables(machine_from_dict(doc['machine'])),
        **_content(doc),
    )  # fmt: skip
    return {REPORT_FILE: page}


def format_diagnosis(doc: Mapping[str, Any]) -> str:
    """Return the text for a terminal."""
    return render('diagnosis.txt.j2', **_content(doc)).rstrip('\n')


def effects_file(run: int) -> str:
    """File of the effects in one run; further runs have one where theirs differ."""
    return f'effects_run_{run + 1}.yaml' if run else 'effects.yaml'


@limit_to_one_thread
def write_diagnosis(
    diagnosis: Diagnosis, folder: str | Path, report: str = REPORT_FILE
) -> list[Path]:
    """Write gap.json, report.html, and with causes effects.yaml and both calibrations.

    Parameters
    ----------
    folder : str or Path
        Made if missing.
    report : str
        Name of the report.

    Returns
    -------
    list of Path
        gap.json last.
    """
    folder = ensure_folder(folder)
    written: list[Path] = []
    first, calibration = diagnosis.applied[0], diagnosis.calibration
    if first:
        for number, applied in enumerate(diagnosis.applied):
            if not number or applied != first:
                written.append(folder / effects_file(number))
                write_effects(written[-1], applied, diagnosis.machine)
    tables = {}
    if first and diagnosis.causes and calibration.applied:
        tables['calibration_plain'] = calibration.plain
        tables['calibration_with_effects'] = calibration
        written.append(folder / 'calibration_with_effects')
    file, content = diagnosis.document.file, diagnosis.document.to_dict()

    def write(name: str) -> None:
        if name in tables:
            write_calibration(
                replace(tables[name], uncorrected=None, applied=()),
                folder / name,
                certificate=False,
            )
        else:
            write_text(folder / name, gap_pages(content)[REPORT_FILE])

    share_out(write, [report, *tables])
    write_text(folder / file, json.dumps(content, indent=1) + '\n')
    return [*written, folder / report, folder / file]

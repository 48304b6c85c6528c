# SPDX-License-Identifier: Apache-2.0
"""Page and text of a fleet.json: runs side by side."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from otf_core.model.expanded import figure, micro_unit, significant, with_expanded
from otf_core.model.motions import SQUARENESS, unit_of
from otf_core.prediction.absorbed import offset_words
from otf_core.prediction.calibration_document import (
    LIMIT_NOT_PROVEN,
    MEASUREMENT_FAILED,
    STATE_WORDS,
)
from otf_core.reports.calibration_errors import MOODS
from otf_core.reports.rendering import State, render

PAGE = 'fleet.html'
Row = list[str | State]

TABLE_COLUMNS = (
    'run', 'machine', 'measurement', 'limits', 'error, mean (um)', 'error, largest (um)',
    'expected after, largest U (um)', *(f'{name} (urad)' for name in SQUARENESS),
    'target offset', 'remark',
)  # fmt: skip
GAP_COLUMNS = ('run', 'machine', 'verdict', 'measured (um)', 'simulated (um)', 'causes', 'remark')
JUDGED = {
    MEASUREMENT_FAILED: 'measurement not good',
    LIMIT_NOT_PROVEN: 'limits of the machine not proven to be met',
}
"""What exit codes of runs say that are done."""
UNKNOWN = 'not known'


def _calibrated(name: str, own: Mapping[str, Any], remark: str) -> Row:
    """Row of a run; location errors of rotary axes among the remarks."""
    error, k, state = own['error'], own['k'], own['limits']
    wide = {size: k * u for size, u in own['u'].items()}
    words = {n: _scalar(own, n) for n in own['scalars'] if n not in SQUARENESS}
    known = [f'{n} {w} {micro_unit(unit_of(n))}' for n, w in words.items() if w != UNKNOWN]
    known += [f'{n} {w}' for n, w in words.items() if w == UNKNOWN]
    remarks = [remark, f'location errors: {", ".join(known)}' if known else '']
    return [
        name,
        own['machine'],
        State('good', 'good') if own['good'] else State('not good', 'bad'),
        State(STATE_WORDS.get(state, state), MOODS.get(state, '')),
        figure(1e6 * error['mean'], 1e6 * wide['mean']),
        with_expanded(1e6 * error['max'], 1e6 * k * own['u_of_largest']),
        significant(1e6 * wide['max']),
        *(_scalar(own, k) for k in SQUARENESS),
        offset_words(np.array(own['target_offset'])),
        '; '.join(filter(None, remarks)),
    ]


def _scalar(own: Mapping[str, Any], name: str) -> str:
    """Value and U of a scalar error; a star where it holds at one target offset only."""
    if name not in own['scalars']:
        return '-'
    entry = own['scalars'][name]
    if entry is None:
        return UNKNOWN
    star = '*' if name in own['target_offset_bound']['contains'] else ''
    return f'{with_expanded(1e6 * entry["value"], 1e6 * entry["k"] * entry["u"])}{star}'


def _diagnosed(name: str, own: Mapping[str, Any], remark: str) -> Row:
    sizes = (f'{own[f"{kind}_um"]:.2f}' for kind in ('measured', 'simulated'))
    return [name, own['machine'], own['verdict'], *sizes, ', '.join(own['causes']) or '-', remark]


def fleet_rows(doc: Mapping[str, Any]) -> tuple[tuple[str, ...], list[Row], list[str]]:
    """Columns, a row per run that is done, and what many runs share, of a fleet.json."""
    results, runs = doc['results'], doc['runs']
    if doc['verb'] == 'calibrate':
        rows = [_calibrated(n, own, runs[n]['message']) for n, own in results.items()]
        return TABLE_COLUMNS, rows, doc['warnings']
    counts = Counter(cause for own in results.values() for cause in set(own['causes']))
    shared = [
        f'{cause}: {count} of {len(results)} runs'
        for cause, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))
        if count > 1
    ]
    return (
        GAP_COLUMNS,
        [_diagnosed(n, own, runs[n]['message']) for n, own in results.items()],
        shared,
    )


def _judged(doc: Mapping[str, Any]) -> dict[str, list[str]]:
    """Runs that are done, by what their exit code says."""
    named = {
        words: [n for n, own in doc['runs'].items() if n in doc['results'] and own['exit'] == code]
        for code, words in JUDGED.items()
    }
    return {words: names for words, names in named.items() if names}


def format_fleet(doc: Mapping[str, Any]) -> str:
    """Return the text for a terminal: counts, every run that failed, and verdicts not good."""
    failed = {n: o for n, o in doc['runs'].items() if n not in doc['results']}
    lines = [f'{doc["done"]} of {len(doc["runs"])} runs done, {doc["failed"]} failed']
    lines += [f'  {n}: exit {o["exit"]}: {o["message"]}' for n, o in failed.items()]
    lines += [f'  {words}: {", ".join(names)}' for words, names in _judged(doc).items()]
    return '\n'.join([*lines, *doc['warnings']])


def fleet_pages(doc: Mapping[str, Any]) -> dict[str, str]:
    """Return the page of machines side by side."""
    columns, rows, shared = fleet_rows(doc)
    failed = [(n, o['exit'], o['message']) for n, o in doc['runs'].items()
              if n not in doc['results']]  # fmt: skip
    badge = State('some failed', 'bad') if failed else State('all done', 'good')
    page = render('fleet.html.j2', d=doc, columns=columns, rows=rows, shared=shared,
                  failed=failed, badges=[badge], judged=_judged(doc))  # fmt: skip
    return {PAGE: page}

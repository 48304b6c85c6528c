# SPDX-License-Identifier: Apache-2.0
"""A fleet side by side: text, fleet.json, fleet.html."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.files.output_folder import MANIFEST, write_manifest, written_files
from otf_core.files.writing import write_text
from otf_core.fleet.fleet import FILE, PAGE, JobResult, fleet_to_dict, listed_results
from otf_core.model.expanded import COVERAGE_FACTOR, figure, micro_unit, significant, with_expanded
from otf_core.model.motions import MOTIONS, SQUARENESS, unit_of
from otf_core.prediction.absorbed import offset_words
from otf_core.prediction.calibration_document import LIMIT_NOT_PROVEN, MEASUREMENT_FAILED
from otf_core.reports.page import Heading, Section, State, Table, page_html

Row = list[str | State]
STATES = {'pass': 'kept', 'fail': 'broken'}
MOODS = {'pass': 'good', 'fail': 'bad', 'not proven': 'open', 'not known': 'open'}

TABLE_COLUMNS = (
    'run', 'machine', 'measurement', 'limits', 'error, mean (um)', 'error, largest (um)',
    'expected after, largest U (um)', *(f'{name} (urad)' for name in SQUARENESS),
    'target offset', 'remark',
)  # fmt: skip
JUDGED = {
    MEASUREMENT_FAILED: 'measurement not good',
    LIMIT_NOT_PROVEN: 'limits of the machine not proven to be met',
}
"""What exit codes of runs say that are done."""
UNKNOWN = 'not known'
GAP_COLUMNS = ('run', 'machine', 'verdict', 'measured (um)', 'simulated (um)', 'causes', 'remark')


def _calibrated(name: str, data: Mapping[str, Any], remark: str) -> Row:
    """Row of a run; location errors of rotary axes among the remarks."""
    verdicts, machine = data['verdicts'], data['machine']
    good, state = verdicts['measurement']['good'], verdicts['machine']['state']
    first = data['headline']
    wide = {size: first['k'] * u for size, u in first['u'].items()}
    words = {n: _scalar(data, n) for n in data.get('location', ())}
    location = [f'{n} {w} {micro_unit(unit_of(n))}' for n, w in words.items() if w != UNKNOWN]
    location += [f'{n} {w}' for n, w in words.items() if w == UNKNOWN]
    remarks = [remark, f'location errors: {", ".join(location)}' if location else '']
    return [
        name,
        str(machine['name']),
        State('good', 'good') if good else State('not good', 'bad'),
        State(STATES.get(state, state), MOODS.get(state, '')),
        figure(1e6 * first['error']['mean'], 1e6 * wide['mean']),
        with_expanded(1e6 * first['error']['max'], 1e6 * first['k'] * first['u_of_largest']),
        significant(1e6 * wide['max']),
        *(_scalar(data, k) for k in SQUARENESS),
        offset_words(np.array(machine['target_offset'])),
        '; '.join(filter(None, remarks)),
    ]


def _scalar(data: Mapping[str, Any], name: str) -> str:
    """Value and U of a scalar error; a star where it holds at one target offset only."""
    kind = 'squareness' if name in SQUARENESS else 'location'
    if name not in data[kind]:
        return '-'
    if name in data['not_identifiable']:
        return UNKNOWN
    entry = data[kind][name]
    star = '*' if name in data['target_offset_bound']['contains'] else ''
    wide = entry.get('k', COVERAGE_FACTOR) * entry['u']
    return f'{with_expanded(1e6 * entry["value"], 1e6 * wide)}{star}'


def offset_remarks(bound: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What is to be minded where values hold at the target offset of their own run only.

    Parameters
    ----------
    bound : mapping of run to its ``target_offset_bound``
    """
    contains = [
        n for n in (*SQUARENESS, *MOTIONS) if any(n in b['contains'] for b in bound.values())
    ]
    if not contains:
        return []
    star = (
        f'* holds at the target offset of its run only: {", ".join(contains)} contain rotations '
        f'that the data do not show.'
    )
    runs: dict[str, list[str]] = {}
    for name, one in bound.items():
        if one['contains']:
            runs.setdefault(offset_words(np.array(one['offset'])), []).append(name)
    if len(runs) == 1:
        return [star]
    offsets = '; '.join(f'{offset}: {", ".join(names)}' for offset, names in runs.items())
    return [star, f'WARNING target offsets differ ({offsets}): compare these values among runs of '
            f'one offset only.']  # fmt: skip


def _diagnosed(name: str, data: Mapping[str, Any], remark: str) -> Row:
    gap = data['gap']
    machines = data.get('provenance', {}).get('machines', [{}])
    return [
        name, str(machines[0].get('name', '')), str(data['verdict']),
        f'{gap["measured_um"]:.2f}', f'{gap["simulated_um"]:.2f}',
        ', '.join(cause_names(data)) or '-', remark,
    ]  # fmt: skip


def cause_names(data: Mapping[str, Any]) -> list[str]:
    """Causes of a gap.json with their axes."""
    return [
        f'{cause["effect"]} {" ".join(cause.get("axes") or [])}'.strip()
        for cause in data['causes']
    ]


def fleet_rows(
    verb: str, folder: Path, outcomes: Mapping[str, JobResult]
) -> tuple[tuple[str, ...], list[Row], list[str]]:
    """Columns, a row per run that is done, and what many runs share.

    Parameters
    ----------
    verb : str
        'calibrate' or 'diagnose'.
    outcomes : mapping of run to JobResult
    """
    rows: list[Row] = []
    bound, counts = {}, Counter[str]()
    for name, data in listed_results(verb, folder, outcomes):
        if verb == 'calibrate':
            rows.append(_calibrated(name, data, outcomes[name].message))
            bound[name] = data['target_offset_bound']
        else:
            rows.append(_diagnosed(name, data, outcomes[name].message))
            counts.update(set(cause_names(data)))
    if verb == 'calibrate':
        return TABLE_COLUMNS, rows, offset_remarks(bound)
    shared = [
        f'{cause}: {count} of {len(rows)} runs'
        for cause, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))
        if count > 1
    ]
    return GAP_COLUMNS, rows, shared


def format_fleet(verb: str, outcomes: Mapping[str, JobResult]) -> str:
    """Return the text for a terminal: counts, every run that failed, and verdicts not good."""
    data = fleet_to_dict(verb, outcomes)
    lines = [f'{data["done"]} of {len(outcomes)} runs done, {data["failed"]} failed']
    lines += [f'  {n}: exit {o.exit}: {o.message}' for n, o in outcomes.items() if not o.done]
    for code, verdict in JUDGED.items():
        named = [n for n, o in outcomes.items() if o.done and o.exit == code]
        if named:
            lines.append(f'  {verdict}: {", ".join(named)}')
    return '\n'.join(lines)


def fleet_page(
    verb: str,
    outcomes: Mapping[str, JobResult],
    columns: Sequence[str],
    rows: Sequence[Row],
    shared: Sequence[str],
) -> str:
    """Return the page of machines side by side: self-contained HTML of ``fleet_rows``."""
    numbers = tuple(k for k, column in enumerate(columns) if '(u' in column)
    failed = tuple((n, str(o.exit), o.message) for n, o in outcomes.items() if not o.done)
    counts = [f'{len(rows)} of {len(outcomes)} runs done', f'{len(failed)} failed']
    counts += [
        f'{count} with {words}'
        for code, words in JUDGED.items()
        if (count := sum(o.done and o.exit == code for o in outcomes.values()))
    ]
    sections = [
        Section('fleet', '', tuple(shared)),
        Section(
            'runs',
            'Side by side',
            tables=(Table(tuple(columns), tuple(map(tuple, rows)), numbers, stacked=True),),
        ),
    ]
    if failed:
        table = Table(('run', 'exit', 'message'), failed, (1,), stacked=True)
        sections.insert(1, Section('failed', 'Failed', tables=(table,)))
    heading = Heading(
        f'Fleet: otf {verb}',
        f'{", ".join(counts)}.',
        (State('some failed', 'bad') if failed else State('all done', 'good'),),
    )
    return page_html(heading, sections)


def write_fleet(
    verb: str, folder: Path, outcomes: Mapping[str, JobResult]
) -> tuple[list[Path], list[str]]:
    """Write fleet.json and fleet.html into the folder of a fleet.

    Returns
    -------
    files : list of Path
    warnings : list of str
        What is to be minded where calibrations with differing target offsets lie side by side.
    """
    columns, rows, shared = fleet_rows(verb, folder, outcomes)
    write_text(folder / PAGE, fleet_page(verb, outcomes, columns, rows, shared))
    warnings = shared if verb == 'calibrate' else []
    data = fleet_to_dict(verb, outcomes) | {'warnings': warnings}
    write_text(folder / FILE, json.dumps(data, indent=1) + '\n')
    write_manifest(folder / MANIFEST, written_files(folder), f'fleet {verb}')
    return [folder / FILE, folder / PAGE], warnings

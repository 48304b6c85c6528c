# SPDX-License-Identifier: Apache-2.0
"""A fleet side by side: text, fleet.json, fleet.html."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from otf_core.files.manifest import MANIFEST, write_manifest, written_files
from otf_core.files.writing import write_text
from otf_core.fleet.fleet import FILE, PAGE, fleet_to_dict
from otf_core.fleet.job import JobResult
from otf_core.fleet.listed import listed_results
from otf_core.model.motions import SQUARENESS
from otf_core.reports.page import Heading, page_html
from otf_core.reports.section import Section, State, Table

Row = list[str]

TABLE_COLUMNS = (
    'run', 'machine', 'volumetric error (um)', 'largest (um)', 'residual (um)',
    *(f'{name} (urad)' for name in SQUARENESS), 'remark',
)  # fmt: skip
GAP_COLUMNS = ('run', 'machine', 'verdict', 'measured (um)', 'simulated (um)', 'causes', 'remark')


def _calibrated(name: str, data: Mapping[str, Any], remark: str) -> Row:
    error, square = data['volumetric_error'], data['squareness']
    hidden = data.get('not_identifiable', ())
    sizes = (error['mean'], error['max'], data['fit']['residual_rms'])
    return [
        name, str(data['machine']['name']), *(f'{1e6 * v:.2f}' for v in sizes),
        *('not known' if k in hidden else f'{1e6 * square[k]["value"]:.1f}' for k in SQUARENESS),
        remark,
    ]  # fmt: skip


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
    folder : Path
    outcomes : mapping of run to JobResult
    """
    done = list(listed_results(verb, folder, outcomes))
    if verb == 'calibrate':
        rows = [_calibrated(name, data, outcomes[name].message) for name, data in done]
        return TABLE_COLUMNS, rows, []
    rows = [_diagnosed(name, data, outcomes[name].message) for name, data in done]
    counts = Counter(cause for _, data in done for cause in set(cause_names(data)))
    shared = [
        f'{cause}: {count} of {len(done)} runs'
        for cause, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))
        if count > 1
    ]
    return GAP_COLUMNS, rows, shared


def format_fleet(verb: str, outcomes: Mapping[str, JobResult], *, gates: bool = True) -> str:
    """Return the text for a terminal: counts, every run that failed and, with ``gates``, those."""
    data = fleet_to_dict(verb, outcomes)
    lines = [f'{data["done"]} of {len(outcomes)} runs done, {data["failed"]} failed']
    lines += [f'  {n}: exit {o.exit}: {o.message}' for n, o in outcomes.items() if not o.done]
    beyond = [n for n, o in outcomes.items() if o.done and o.exit]
    if beyond and gates:
        lines.append(f'  quality gate failed: {", ".join(beyond)}')
    return '\n'.join(lines)


def fleet_page(verb: str, folder: Path, outcomes: Mapping[str, JobResult]) -> str:
    """Return the page of machines side by side: self-contained HTML."""
    columns, rows, shared = fleet_rows(verb, folder, outcomes)
    numbers = tuple(k for k, column in enumerate(columns) if '(u' in column)
    failed = tuple((n, str(o.exit), o.message) for n, o in outcomes.items() if not o.done)
    gates = sum(o.done and o.exit != 0 for o in outcomes.values())
    sections = [
        Section('fleet', '', tuple(shared)),
        Section(
            'runs',
            'Side by side',
            tables=(Table(columns, tuple(map(tuple, rows)), numbers, stacked=True),),
        ),
    ]
    if failed:
        table = Table(('run', 'exit', 'message'), failed, (1,), stacked=True)
        sections.insert(1, Section('failed', 'Failed', tables=(table,)))
    heading = Heading(
        f'Fleet: otf {verb}',
        f'{len(rows)} of {len(outcomes)} runs done, {len(failed)} failed, {gates} with a quality '
        f'gate that failed.',
        (State('some failed', 'bad') if failed else State('all done', 'good'),),
    )
    return page_html(heading, sections)


def write_fleet(verb: str, folder: Path, outcomes: Mapping[str, JobResult]) -> list[Path]:
    """Write fleet.json and fleet.html into the folder of a fleet.

    Returns
    -------
    list of Path
    """
    write_text(folder / PAGE, fleet_page(verb, folder, outcomes))
    file = write_outcomes(verb, folder, outcomes)
    list_results(verb, folder)
    return [file, folder / PAGE]


def list_results(verb: str, folder: Path) -> None:
    """Write the manifest of a fleet."""
    write_manifest(folder / MANIFEST, written_files(folder), f'fleet {verb}')


def write_outcomes(verb: str, folder: Path, outcomes: Mapping[str, JobResult]) -> Path:
    """Write fleet.json into the folder of a fleet; its path."""
    data = fleet_to_dict(verb, outcomes)
    write_text(folder / FILE, json.dumps(data, indent=1) + '\n')
    return folder / FILE

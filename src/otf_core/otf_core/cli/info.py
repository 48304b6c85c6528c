# SPDX-License-Identifier: Apache-2.0
"""Verb info: what a file is called, its schema, its headline, where it comes from."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from otf_core.cli.output import answer
from otf_core.errors import ConfigError, InputError


def _of_tables(data: Mapping[str, Any]) -> str:
    from otf_core.prediction.calibration_document import tables_from_dict

    document = tables_from_dict(data, 'file')
    said = [f'{document.machine.name}, chain {document.machine.chain}']
    said += document.verdicts.words[:2] if document.verdicts else ()
    said += document.headline.sentences[:1] if document.headline else ()
    return '; '.join([*said, f'not seen: {", ".join(document.not_identifiable) or "none"}'])


def _of_plan(data: Mapping[str, Any]) -> str:
    parts = ', '.join(
        f'{p["target"]} ({len(p["positions"])} corner points)' for p in data['parts']
    )
    hidden = [n for n, own in data['forecast']['errors'].items() if not own['identifiable']]
    words = f'{data["length"]:.2f} m, {data["duration"]:.0f} s; parts {parts}'
    return f'{words}; not shown: {", ".join(hidden) or "none"}'


KINDS: dict[str, tuple[str, Callable[[Mapping[str, Any]], str]]] = {
    'otf-error-tables/1': ('error tables', _of_tables),
    'otf-error-tables/2': ('error tables', _of_tables),
    'otf-gap/1': ('diagnosis', lambda d: f'{d["verdict"]}: {d.get("sentence", "")}'),
    'otf-plan/2': ('plan', _of_plan),
    'otf-noise/1': ('noise', lambda d: f'{1e6 * d["u_range"]:.3f} um along the beam, '
                    + ' and '.join(f'{1e6 * v:.3f}' for v in d['u_angle']) + ' urad across'),
    'otf-comparison/2': ('comparison', lambda d: f'{d["a"]} and {d["b"]} differ by '
                         f'{1e6 * d["volume"]["mae_difference"]:.2f} um on average'),
    'otf-simulation/1': ('truth of a simulation', lambda d: f'seed {d["seed"]}, effects: '
                         f'{", ".join(e["effect"] for e in d["effects"]) or "none"}'),
    'otf-fleet/1': ('fleet', lambda d: f'{d["done"]} runs done, {d["failed"]} failed'),
    'otf-history/1': ('history', lambda d: f'machines {", ".join(d["machines"])}'),
    'otf-manifest/1': ('folder of results', lambda d: f'otf {d["verb"]}: '
                       f'{", ".join(d["sha256"])}'),
}  # fmt: skip
"""Name and headline of a result, by its schema."""
OTHER = ('result', lambda data: f'holds {", ".join(data)}')


def _document(path: Path) -> dict[str, Any]:
    """A result in JSON, or the folder that holds its manifest."""
    from otf_core.files.output_folder import MANIFEST, is_unchanged, listed_files
    from otf_core.files.strict_yaml import read_json

    file = path / MANIFEST if path.is_dir() else path
    data = read_json(file)
    schema = str(data.get('schema', '')) if isinstance(data, dict) else ''
    if not schema.startswith('otf-'):
        raise InputError(f'{path}: is JSON, but not a file that otf writes or reads')
    name, headline = KINDS.get(schema, OTHER)
    try:
        found = {'kind': name, 'schema': schema, 'headline': headline(data)}
    except (KeyError, TypeError, AttributeError, ValueError, ConfigError) as error:
        detail = f'{type(error).__name__}: {error}'
        raise InputError(f"{path}: is not a complete '{schema}' ({detail})") from None
    if path.is_dir():
        entries = listed_files(file)
        changed = [str(f.relative_to(path)) for f in entries if not is_unchanged(f, entries)]
        found |= {'changed': changed}
    return found | {'provenance': data.get('provenance')}


def _bag(path: Path) -> dict[str, Any]:
    from otf_core.bags.bag_reading import BagReading
    from otf_core.bags.rosbag2_metadata import POINT
    from otf_core.inputs.recordings import open_reading

    reading = open_reading(path)
    assert isinstance(reading, BagReading)
    stamps = reading.received().stamp_ns
    seconds = 1e-9 * float(stamps.max() - stamps.min()) if len(stamps) else 0.0
    words = f'{len(stamps)} samples over {seconds:.1f} s'
    if not len(stamps):
        words = f'no samples of {POINT.name}'
    paths = len(reading.paths) + len(reading.axis_paths)
    return {
        'kind': 'recording',
        'schema': 'rosbag2',
        'headline': '; '.join([words, f'{paths} paths', *reading.remarks]),
        'topics': dict(sorted(reading.topics.items())),
        'samples': len(stamps),
        'duration_s': seconds,
    }


def _machine(path: Path) -> dict[str, Any]:
    from otf_core.model.machine import load_machine

    machine = load_machine(path)
    axes = ', '.join(f'{name} {axis.min:g} to {axis.max:g} {"rad" if axis.rotary else "m"}'
                     for name, axis in machine.axes.items())  # fmt: skip
    headline = f'{machine.name}, chain {machine.chain}; {axes}'
    return {'kind': 'machine description', 'schema': 'machine.yaml', 'headline': headline}


def _text(path: Path) -> dict[str, Any]:
    """A lattice, or another file of otf export."""
    from otf_core.exports.format import MARK, is_export
    from otf_core.exports.lattice import holds_lattice, read_lattice_csv

    with path.open(encoding='utf-8', errors='replace') as file:
        lines = [line.strip(' #;/()<>!-\r\n') for line in file if line.strip()]
    exported = next((line for line in lines if line.startswith(MARK)), '')
    if holds_lattice(path):
        points = f'{len(read_lattice_csv(path).points)} points'
        return {'kind': 'lattice', 'schema': 'lattice-csv', 'headline': points}
    if exported and is_export(path):
        form = exported.removeprefix(MARK).partition(':')[0].strip()
        return {'kind': 'export', 'schema': form, 'headline': exported}
    raise InputError(
        f'{path}: is not a file that otf writes or reads; info knows recordings, machine.yaml, '
        f'lattices in CSV, exports and results in JSON'
    )


def file_info(name: str) -> dict[str, Any]:
    """Return kind, schema, headline and provenance of a file.

    Raises
    ------
    ConfigError
        If it cannot be read.
    InputError
        If it is of no kind that otf knows, or not complete.
    """
    from otf_core.bags.bag_source import is_storage
    from otf_core.files.output_folder import MANIFEST
    from otf_core.files.writing import unreadable

    path = Path(name)
    try:
        path.stat()
    except OSError as error:
        raise unreadable(path, error) from None
    folder = path.is_dir() and not (path / MANIFEST).is_file()
    if folder or (path / 'metadata.yaml').is_file() or is_storage(path) or path.suffix == '.bag':
        return _bag(path)
    try:
        if path.is_dir() or path.suffix == '.json':
            return _document(path)
        return _machine(path) if path.suffix in ('.yaml', '.yml') else _text(path)
    except ConfigError as error:
        raise InputError(str(error)) from None


def run_info(arguments: argparse.Namespace) -> int:
    """Identify a file and summarise it."""
    found = file_info(arguments.file)
    about = found.get('provenance') or {}
    lines = [f'{arguments.file}: {found["kind"]}, {found["schema"]}', found['headline']]
    lines += [f'topic {topic}, {kind}' for topic, kind in found.get('topics', {}).items()]
    lines += [f'CHANGED: {file} since otf wrote it' for file in found.get('changed', ())]
    if about:
        software = about.get('software') or {}
        lines.append(f'written {about.get("written")} by {software.get("name")} '
                     f'{software.get("version")}, otf {about.get("verb")}')  # fmt: skip
        lines += [f'run {run["name"]}: {run["samples"]} samples' for run in about.get('runs', ())]
    answer(arguments, '\n'.join(lines), {'file': arguments.file, **found})
    return 0

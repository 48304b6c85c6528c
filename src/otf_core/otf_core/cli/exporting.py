# SPDX-License-Identifier: Apache-2.0
"""Verbs that hand results on, take them and keep them: report, export, import, history."""

from __future__ import annotations

import argparse
import json
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from otf_core.cli.options import AddVerb, add_out, add_sign, output_folder
from otf_core.cli.output import QUALITY_GATE_FAILED, answer, note, report_files
from otf_core.errors import ConfigError
from otf_core.exports import HOMES

if TYPE_CHECKING:
    from otf_core.prediction.calibration_document import CalibrationDocument


# Verbs that hand error tables to controls and other programs, and take them: export, import.


def add_exporting_verbs(verb: AddVerb) -> None:
    """Add report, export and import."""
    sub = verb('report', run_report)
    sub.add_argument('file', metavar='FILE.json', help='result of another verb')
    add_out(sub, 'folder for the page')
    sub = verb('export', run_export)
    sub.add_argument('dir', metavar='DIR', help='results of otf calibrate, or error_tables.json')
    sub.add_argument('--format', required=True, choices=tuple(HOMES), help='format to write')
    add_out(
        sub,
        'file to write; linuxcnc: NAME.ini, with NAME_x.comp, NAME_y.comp, NAME_z.comp',
    )
    sub.add_argument(
        '--sign', choices=('error', 'correction'),
        help='how the control interprets the values, where its manual does not state it',
    )  # fmt: skip
    sub.add_argument(
        '--points', type=int, metavar='N', help='points per axis (default: by format)'
    )

    sub = verb('import', run_import)
    sub.add_argument(
        'file', metavar='FILE', help='lattice x,y,z,dx,dy,dz (m), Etalon exchange format, ISG CSV'
    )
    add_sign(sub)
    sub.add_argument('--machine', required=True, help='machine.yaml: determines how rotations act')
    add_out(sub, 'folder for error_tables.json')


def tables_file(name: str) -> Path:
    """Path of the error tables in a folder of results, or the file itself."""
    path = Path(name)
    return path / 'error_tables.json' if path.is_dir() else path


def run_export(arguments: argparse.Namespace) -> int:
    """Error tables in the format of a control or a program."""
    from otf_core.exports import export_format
    from otf_core.exports.format import Request, is_export, remaining_error
    from otf_core.files.output_folder import OutputFile
    from otf_core.prediction.calibration_document import load_tables

    if arguments.points is not None and arguments.points < 2:
        raise ConfigError(f'--points: {arguments.points}; at least 2')
    source, out = tables_file(arguments.dir), Path(arguments.out)
    content = load_tables(source)
    chosen = export_format(arguments.format)
    request = Request(content, out.name, arguments.sign, arguments.points)
    export = chosen.export(request)
    targets = [
        (OutputFile(
            out.parent / name, is_export, overwrite=arguments.overwrite, inputs=(source,)
        ), packed)
        for name, packed in export.files.items()
    ]  # fmt: skip
    for target, packed in reversed(targets):
        with target.filled() as partial:
            partial.write_bytes(packed)
    remainder = remaining_error(content.tables, export.held, content.headline)
    data: dict[str, Any] = {
        'schema': 'otf-export/1',
        'format': chosen.name,
        'files': [str(target.path) for target, _ in targets],
        'sign': chosen.sign_of(request),
        'lacks': chosen.lacks,
        'remaining': remainder.to_dict(),
        'remarks': list(export.remarks),
    }
    lines = [
        f'sign: {data["sign"]}',
        f'not in the file: {chosen.lacks}',
        remainder.words,
        *export.remarks,
        f'written: {", ".join(map(str, data["files"]))}',
    ]
    answer(arguments, '\n'.join(lines), data)
    return _exit_code(content)


def _exit_code(content: CalibrationDocument) -> int:
    """Exit code by the quality gates of the calibration that the tables come from."""
    failed = content.failed_gates
    for gate in failed:
        note(f'otf export: the calibration is NOT GOOD: {gate}')
    return QUALITY_GATE_FAILED if failed else 0


def run_report(arguments: argparse.Namespace) -> int:
    """The page of a result file, as its verb writes it."""
    from otf_core.files.writing import write_text
    from otf_core.reports.pages import pages_of

    out = output_folder(arguments, arguments.file)
    pages = pages_of(arguments.file)
    with out.filled('report') as folder:
        for name, page in pages.items():
            write_text(folder / name, page)
    written = [Path(arguments.out) / name for name in pages]
    data = {'out': arguments.out, 'files': list(pages)}
    answer(arguments, arguments.file + report_files(written, arguments.out), data)
    return 0


def run_import(arguments: argparse.Namespace) -> int:
    """Error tables from a file of another system."""
    from otf_core.exports.foreign_tables import read_foreign_tables
    from otf_core.files.writing import write_text
    from otf_core.model.machine import load_machine
    from otf_core.model.provenance import provenance
    from otf_core.prediction.calibration_document import CalibrationDocument

    out = output_folder(arguments, arguments.file, arguments.machine)
    machine = load_machine(arguments.machine)
    imported = read_foreign_tables(arguments.file, machine, arguments.sign)
    sizes = {'size_rms_um': 1e6 * imported.size_rms, 'left_rms_um': 1e6 * imported.left_rms}
    block = provenance(
        'import', machines=[machine], files={'tables': arguments.file},
        coverage='no uncertainty: u of other systems is not carried over',
    )  # fmt: skip
    document = CalibrationDocument.of_tables(imported.tables, imported=sizes, provenance=block)
    with out.filled('import') as folder:
        write_text(folder / document.file, json.dumps(document.to_dict(), indent=1) + '\n')
    lines = [f'{arguments.file}: {text}' for text in imported.remarks]
    if imported.size_rms:
        lines.append(
            f'errors of the lattice {sizes["size_rms_um"]:.3f} um rms; the tables leave '
            f'{sizes["left_rms_um"]:.3f} um rms of them'
        )
    words = '\n'.join([*lines, 'u is 0: uncertainties are not carried over'])
    written = [Path(arguments.out) / document.file]
    data = {
        'schema': 'otf-import/1',
        **sizes,
        'remarks': list(imported.remarks),
        'files': list(map(str, written)),
    }
    answer(arguments, words + report_files(written, arguments.out), data)
    return 0


# Verb on results of years: history.


def add_keeping_verbs(verb: AddVerb) -> None:
    """Add history."""
    sub = verb('history', run_history)
    sub.add_argument('store', metavar='STORE', help='folder of runs; the first --add creates it')
    sub.add_argument(
        '--add', action='append', default=[], metavar='RESULTS',
        help='add results of otf calibrate, or an error_tables.json, to the store',
    )  # fmt: skip
    sub.add_argument(
        '--event', metavar='TEXT', help='add an event in the life of the machine to the store'
    )
    sub.add_argument(
        '--at',
        metavar='DATE',
        help='date of the addition, ISO 8601, UTC (default: as measured; now)',
    )
    sub.add_argument('--name', help='name of the machine, if the store contains several')
    sub.add_argument(
        '--limit', type=float, metavar='UM',
        help='permitted mean volumetric drift (um; default: twice u of the latest tables)',
    )  # fmt: skip
    sub.add_argument('--out', help='folder for history.json and history.html')
    sub.add_argument('--overwrite', action='store_true', help='replace existing results')


def _added(arguments: argparse.Namespace) -> int:
    """Put into the store what was given; how much that was."""
    from otf_core.history.store import add_event, add_run

    folder = Path(arguments.store)
    for results in arguments.add:
        name, new = add_run(folder, tables_file(results), arguments.at)
        note(
            f'otf history: {results}: {"added as" if new else "is already in the store as"} {name}'
        )
    if arguments.event is not None:
        now = datetime.now(timezone.utc).isoformat(timespec='seconds')
        name, new = add_event(folder, arguments.event, arguments.at or now, arguments.name or '')
        note(f'otf history: event {"added as" if new else "is already in the store as"} {name}')
    return len(arguments.add) + (arguments.event is not None)


def run_history(arguments: argparse.Namespace) -> int:
    """Drift of the machines of a store."""
    from otf_core.history.control_chart import history_of
    from otf_core.history.document import HistoryDocument, machine_history
    from otf_core.history.store import read_store
    from otf_core.reports.pages import summary_of, write_document

    if arguments.limit is not None and not arguments.limit > 0:
        raise ConfigError(f'--limit: {arguments.limit:g} um is not above 0')
    if arguments.at is not None and not arguments.add and arguments.event is None:
        raise ConfigError('--at: belongs to --add or --event')
    out = output_folder(arguments, arguments.store) if arguments.out else None
    _added(arguments)
    store = read_store(arguments.store)
    machines = [m for m in store.machines if arguments.name in (None, m)]
    if not machines:
        raise ConfigError(
            f'--name: no {arguments.name} in the store; it contains: {", ".join(store.machines)}'
        )
    limit = None if arguments.limit is None else 1e-6 * arguments.limit
    # one at a time: its tables take megabytes
    document = HistoryDocument(
        tuple(machine_history(history_of(store, m, limit)) for m in machines)
    )
    words = summary_of(document)
    if out is not None:
        with out.filled('history') as folder:
            names = [f.name for f in write_document(document, folder)]
        words += report_files([out.path / n for n in names], arguments.out)
    answer(arguments, words, document.to_dict())
    return document.exit_code

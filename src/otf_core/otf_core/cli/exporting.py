# SPDX-License-Identifier: Apache-2.0
"""Verbs that hand error tables to controls and other programs, and take them: export, import."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from otf_core.cli.options import AddVerb, add_out, output_folder
from otf_core.cli.output import QUALITY_GATE_FAILED, answer, listed, note
from otf_core.errors import ConfigError
from otf_core.exports import HOMES

if TYPE_CHECKING:
    from otf_core.model.tables import TablesFile


def add_exporting_verbs(verb: AddVerb) -> None:
    """Add export and import."""
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
    sub.add_argument('lattice', metavar='CSV', help='x,y,z,dx,dy,dz in m, as in lattice-csv')
    sub.add_argument('--machine', required=True, help='machine.yaml: determines how rotations act')
    add_out(sub, 'folder for error_tables.json')


def tables_file(name: str) -> Path:
    """Path of the error tables in a folder of results, or the file itself."""
    path = Path(name)
    return path / 'error_tables.json' if path.is_dir() else path


def run_export(arguments: argparse.Namespace) -> int:
    """Error tables in the format of a control or a program."""
    from otf_core.exports import export_format
    from otf_core.exports.base import Request, is_export
    from otf_core.exports.remaining import remaining_error
    from otf_core.files.output import OutputFile
    from otf_core.model.tables import load_tables

    if arguments.points is not None and arguments.points < 2:
        raise ConfigError(f'--points: {arguments.points}; at least 2')
    source, out = tables_file(arguments.dir), Path(arguments.out)
    content = load_tables(source)
    chosen = export_format(arguments.format)
    request = Request(content, out.name, arguments.sign, arguments.points)
    made = chosen.export(request)
    targets = [
        (OutputFile(
            out.parent / name, is_export, overwrite=arguments.overwrite, inputs=(source,)
        ), packed)
        for name, packed in made.files.items()
    ]  # fmt: skip
    for target, packed in reversed(targets):
        with target.filled() as partial:
            partial.write_bytes(packed)
    left = remaining_error(content.tables, made.held, content.extra.get('headline'))
    data: dict[str, Any] = {
        'schema': 'otf-export/1',
        'format': chosen.name,
        'files': [str(target.path) for target, _ in targets],
        'sign': chosen.sign_words(request),
        'lacks': chosen.lacks,
        'remaining': left.to_dict(),
        'remarks': list(made.remarks),
    }
    lines = [
        f'sign: {data["sign"]}',
        f'not in the file: {chosen.lacks}',
        left.words,
        *made.remarks,
        f'written: {", ".join(map(str, data["files"]))}',
    ]
    answer(arguments, '\n'.join(lines), data)
    return _judged(content)


def _judged(content: TablesFile) -> int:
    """Exit code by the quality gates of the calibration that the tables come from."""
    failed = content.extra.get('failed_gates')
    for gate in failed if isinstance(failed, list) else []:
        note(f'otf export: the calibration is NOT GOOD: {gate}')
    return QUALITY_GATE_FAILED if failed else 0


def run_import(arguments: argparse.Namespace) -> int:
    """Error tables from a lattice of volumetric errors in CSV."""
    from otf_core.exports.imported import tables_from_lattice
    from otf_core.exports.lattice_csv import read_lattice_csv
    from otf_core.files.writing import write_text
    from otf_core.model.machine import load_machine
    from otf_core.model.provenance import provenance
    from otf_core.model.tables import tables_to_dict

    out = output_folder(arguments, arguments.lattice, arguments.machine)
    machine = load_machine(arguments.machine)
    found = tables_from_lattice(read_lattice_csv(arguments.lattice), machine)
    sizes = {'size_rms_um': 1e6 * found.size_rms, 'left_rms_um': 1e6 * found.left_rms}
    block = provenance(
        'import', machines=[machine], files={'lattice': arguments.lattice},
        coverage='no uncertainty: u of the lattice is not carried over',
    )  # fmt: skip
    content = tables_to_dict(found.tables) | {'imported': sizes, 'provenance': block}
    with out.filled('import') as folder:
        write_text(folder / 'error_tables.json', json.dumps(content, indent=1) + '\n')
    words = (
        f'errors of the lattice {sizes["size_rms_um"]:.3f} um rms; the tables leave '
        f'{sizes["left_rms_um"]:.3f} um rms of them; u is 0: none was carried over'
    )
    written = [Path(arguments.out) / 'error_tables.json']
    data = {'schema': 'otf-import/1', **sizes, 'files': list(map(str, written))}
    answer(arguments, words + listed(written, arguments.out), data)
    return 0

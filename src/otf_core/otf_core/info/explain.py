# SPDX-License-Identifier: Apache-2.0
"""What a file is and says: kinds that otf writes, kinds that people bring."""

from __future__ import annotations

import csv
import math
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.bags.bag_reading import BagReading, path_of
from otf_core.bags.bag_source import is_storage
from otf_core.bags.rosbag2_metadata import PATH, POINT
from otf_core.errors import ConfigError, InputError, OtfError
from otf_core.exports.format import MARK, MARK_BYTES, is_export
from otf_core.files.output_folder import MANIFEST, is_unchanged, listed_files
from otf_core.files.strict_yaml import read_json, read_yaml
from otf_core.files.writing import unreadable
from otf_core.inputs.columns import find_columns, read_table
from otf_core.inputs.nc_program import is_program, read_program
from otf_core.inputs.path_file import (
    ROTARY_SCHEMA,
    holds_axis_positions,
    read_axis_paths,
    read_points,
)
from otf_core.inputs.text_points import TextReading, is_text
from otf_core.model.axis_path import AxisPath
from otf_core.model.expanded import (
    COVERAGE_FACTOR,
    micro_figure,
    micro_significant,
    micro_with_expanded,
)
from otf_core.model.machine import load_machine
from otf_core.model.motions import unit_of
from otf_core.model.provenance import moment
from otf_core.prediction.absorbed import offset_words

# A kind of file: how it is known, and what it says.


@dataclass(frozen=True)
class FileSummary:
    """What a file says.

    Attributes
    ----------
    rows : tuple of (str, str)
        What is looked at, and what it is; for people.
    facts : mapping of str to plain data
        For programs; SI units unless a name says otherwise.
    """

    rows: tuple[tuple[str, str], ...]
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class FileKind:
    """A kind of file or folder.

    Attributes
    ----------
    what : str
        What it is good for, one sentence.
    is_one : callable
        Path to bool.
    explain : callable
        Path to Explained.
    """

    name: str
    what: str
    is_one: Callable[[Path], bool]
    explain: Callable[[Path], FileSummary]


def begins_with(path: Path, *starts: str) -> bool:
    """Return whether the first line of a text file that is not a comment begins so."""
    try:
        with path.open(encoding='utf-8-sig') as file:
            lines = (line for line in file if line.strip() and not line.startswith('#'))
            return next(lines, '').startswith(starts)
    except (OSError, UnicodeDecodeError):
        return False


# What otf writes: folders, result files in JSON, residuals, exports.

Data = Mapping[str, Any]
Rows = list[tuple[str, str]]
EXPORT_HEAD = re.compile(
    MARK + r' (?P<format>[\w-]+): machine (?P<machine>.*), chain (?P<chain>\S+), run (?P<run>\S+)'
)
EXPORT_LINES = {
    'measured at the target offset ': 'target offset',
    'sign: ': 'sign',
    'values: ': 'values',
    'not in this file: ': 'not in it',
    'zero because the calibration does not determine them: ': 'not seen',
}
"""Beginnings of the further lines of a head, and what they are about."""


def _explain_folder(path: Path) -> FileSummary:
    entries = listed_files(path / MANIFEST)
    verb = str(read_json(path / MANIFEST).get('verb'))
    changed = [str(f.relative_to(path)) for f in entries if not is_unchanged(f, entries)]
    names = sorted(f.name for f in entries)
    rows = [('by', f'otf {verb}'), ('files', ', '.join(names))]
    rows += [('CHANGED', f'{name}: has been modified') for name in changed]
    facts: dict[str, object] = {'by': verb, 'files': names, 'changed': changed}
    for file in sorted(f for f in entries if f.parent == path and f.suffix == '.json'):
        kind = next((k for k in JSON_KINDS if k.is_one(file)), None)
        if kind is not None:
            explanation = kind.explain(file)
            rows += [(file.name, kind.what), *((f'  {a}', b) for a, b in explanation.rows)]
            facts[file.name] = dict(explanation.facts)
    return FileSummary(tuple(rows), facts)


FOLDER = FileKind(
    'folder of results',
    'what one command wrote, with the hash of every file',
    lambda path: path.is_dir() and bool(listed_files(path / MANIFEST)),
    _explain_folder,
)


def _provenance_rows(data: Data) -> Rows:
    """What the block provenance says."""
    block = data.get('provenance') or {}
    software = block.get('software') or {}
    rows = []
    if block:
        method = f', method {block["method"]}' if block.get('method') else ''
        rows.append((
            'written', f'{block.get("written")} by {software.get("name")} '
            f'{software.get("version")}, otf {block.get("verb")}{method}',
        ))  # fmt: skip
    measured = block.get('measured') or {}
    if measured.get('first'):
        rows.append(('measured', f'{measured["first"]} to {measured["last"]}'))
    runs = block.get('runs') or []
    if runs:
        rows.append(('runs', ', '.join(f'{r["name"]} ({r["samples"]} samples)' for r in runs)))
    return rows


def _explain_tables(data: Data) -> FileSummary:
    fit, machine = data.get('fit') or {}, data['machine']
    rows: Rows = [('machine', f'{machine.get("name")}, chain {machine.get("chain")}')]
    if 'path_mae_before' in fit:
        rows.append((
            'path', f'{1e6 * fit["path_mae_before"]:.2f} um off it on average, compensated '
            f'{1e6 * fit["path_mae_after"]:.2f} um',
        ))  # fmt: skip
    volume = data.get('volumetric_error') or {}
    first = data.get('headline')
    if first:
        after = first['expected_after_compensation']
        U = after['U']
        error = first['error']
        rows.append((
            'volume', f'mean {micro_figure(error["mean"], U["mean"])}, largest '
            f'{micro_with_expanded(error["max"], first["U_of_largest"])}, at {first["points"]} '
            f'points',
        ))  # fmt: skip
        rows.append((
            'expected', f'after compensation: mean {micro_significant(U["mean"])}, largest '
            f'{micro_significant(U["max"])} (U, k = {after["k"]:.3g}; systematic contributions '
            f'{after["systematic"]})',
        ))  # fmt: skip
    elif volume:
        rows.append((
            'volume', f'errors of {1e6 * volume["mean"]:.2f} um on average, at most '
            f'{1e6 * volume["max"]:.2f} um, at {volume["points"]} points',
        ))  # fmt: skip
    verdicts = data.get('verdicts') or {}
    rows += [('verdict', verdict['sentence']) for verdict in verdicts.values()]
    bound = data.get('target_offset_bound') or {}
    if bound.get('contains'):
        offset = offset_words(np.array(bound['offset']))
        rows.append(('holds', f'at target offset {offset} only: {", ".join(bound["contains"])}'))
    unseen = data.get('not_identifiable')
    if unseen is None:
        unseen = [m for m, table in data['motions'].items() if not table['identifiable']]
    rows.append(('not seen', ', '.join(unseen) or 'none'))
    rows += [('WARNING', text) for text in data.get('warnings') or ()]
    if not verdicts:
        rows += [('GATE FAILED', text) for text in data.get('failed_gates') or ()]
    facts = {
        'machine': machine,
        'fit': fit,
        'volumetric_error': volume,
        'headline': first,
        'verdicts': verdicts,
        'not_seen': unseen,
    }
    return FileSummary(tuple(rows), facts)


def _explain_axis_tables(data: Data) -> FileSummary:
    """Tables of a machine with rotary axes: the same, and the lines of its axes."""
    common = _explain_tables(data)
    typical = (data.get('typical_systematic') or {}).get('location') or {}
    lines = []
    for name, entry in data['location'].items():
        if not entry.get('identifiable', True):
            lines.append(f'{name} not seen')
            continue
        u = typical.get(name, entry)['u']
        lines.append(f'{name} {_with_u(entry["value"], u, unit_of(name))}')
    reversal = data.get('reversal') or {}
    found = []
    for name, entry in (reversal.get('motions') or {}).items():
        value, u = (float(np.mean(entry[k])) for k in ('value', 'u'))
        found.append(f'{name} {_with_u(value, u, entry["unit"])}')
    found += [
        f'lag of {axis} {1e6 * entry["value"]:.0f} us'
        for axis, entry in (reversal.get('lags') or {}).items()
    ]
    rows: Rows = [('lines', '; '.join(lines))]
    if found:
        rows.append(('reversal', '; '.join(found)))
    facts = {'location': data['location'], 'reversal': reversal}
    return FileSummary((*common.rows, *rows), {**common.facts, **facts})


def _with_u(value: float, u: float, unit: str) -> str:
    return micro_with_expanded(value, COVERAGE_FACTOR * u, unit)


def _explain_gap(data: Data) -> FileSummary:
    gap = data['gap']
    rows: Rows = [('verdict', f'{data["verdict"]}: {data.get("sentence", "")}')]
    rows.append((
        'gap', f'{gap["before_um"]:.2f} um, with the causes removed {gap["after_um"]:.2f} um',
    ))  # fmt: skip
    rows += [
        (
            'cause',
            f'{c["effect"]} ({", ".join(c["axes"]) or "no axis"}), '
            f'{100 * c["confidence"]:.0f} % sure, shrinks the gap by {c["shrink_percent"]:.0f} %',
        )
        for c in data['causes']
    ]
    rows += [('not visible', f'{n["effect"]}: needs {n["needs"]}') for n in data['not_visible']]
    keys = ('verdict', 'gap', 'causes', 'unexplained', 'not_visible')
    return FileSummary(tuple(rows), {key: data[key] for key in keys})


def _explain_plan(data: Data) -> FileSummary:
    forecast = data.get('forecast') or {}
    rows: Rows = [(
        'path', f'{len(data["path"])} corner points, {data.get("length", 0.0):.2f} m, '
        f'{data.get("duration", 0.0):.0f} s',
    )]  # fmt: skip
    after = (data.get('systematic') or {}).get('expected_after_compensation')
    if after:
        U = after['U']
        rows.append((
            'forecast', f'mean {micro_significant(U["mean"])}, largest '
            f'{micro_significant(U["max"])} (U, k = {after["k"]:.3g}; systematic contributions '
            f'{after["systematic"]})',
        ))  # fmt: skip
    elif 'mean_grid_u' in forecast:
        u = f'{1e6 * forecast["mean_grid_u"]:.3f} um on average in the volume'
        rows.append(('forecast', f'{u} (k = 1, noise alone)'))
    facts = {
        'points': len(data['path']),
        'length': data.get('length'),
        'duration': data.get('duration'),
        'mean_grid_u': forecast.get('mean_grid_u'),
        'tracker_place': (data.get('assumed') or {}).get('tracker_place'),
    }
    return FileSummary(tuple(rows), facts)


def _explain_rotary_plan(data: Data) -> FileSummary:
    forecast, parts = data['forecast'], data['parts']
    grid = f'{1e6 * forecast["grid_u"]:.2f} um on average over the ranges driven'
    rows = (
        ('parts', ', '.join(f'{p["target"]} ({p["duration"] / 60:.1f} min)' for p in parts)),
        ('forecast', f'{grid} (k = 1, noise alone)'),
        ('not shown', ', '.join(forecast['hidden']) or 'none'),
    )
    return FileSummary(rows, {'parts': [p['target'] for p in parts]})


def _explain_noise(data: Data) -> FileSummary:
    angle = ' and '.join(f'{1e6 * v:.3f}' for v in data['u_angle'])
    rows = (
        ('noise', f'{1e6 * data["u_range"]:.3f} um along the beam, {angle} urad across (k = 1)'),
        ('from', f'{data["standstills"]} standstills, {data["samples"]} samples'),
    )
    keys = ('u_range', 'u_angle', 'correlation_time', 'standstills', 'samples')
    return FileSummary(rows, {key: data[key] for key in keys})


def _explain_comparison(data: Data) -> FileSummary:
    volume = data['volume']
    within = 'neither source states an uncertainty'
    if volume['within'] is not None:
        within = f'{100 * volume["within"]:.0f} % of normalised errors at most 1'
    rows = (
        ('of', f'{data["a"]} and {data["b"]}'),
        ('volume', f'differ by {1e6 * volume["mae_difference"]:.2f} um on average'),
        ('within', within),
    )
    return FileSummary(rows, {'a': data['a'], 'b': data['b'], 'volume': volume})


def _explain_simulation(data: Data) -> FileSummary:
    effects = [e['effect'] for e in data['effects']]
    rows = (('seed', str(data['seed'])), ('effects', ', '.join(effects) or 'none'))
    return FileSummary(rows, {'seed': data['seed'], 'effects': effects})


def _explain_manifest(data: Data) -> FileSummary:
    files = list(data['sha256'])
    rows = (('by', f'otf {data["verb"]} {data["version"]}'), ('files', ', '.join(files)))
    return FileSummary(rows, {'by': data['verb'], 'files': files})


def _explain_fleet(data: Data) -> FileSummary:
    failed = {name: run['message'] for name, run in data['runs'].items() if run['exit']}
    rows: Rows = [('runs', f'{data["done"]} done, {data["failed"]} failed')]
    rows += [('FAILED', f'{name}: {message}') for name, message in failed.items()]
    return FileSummary(tuple(rows), {key: data[key] for key in ('done', 'failed', 'runs')})


def _schema_of(path: Path) -> str:
    data = read_json(path)
    return str(data.get('schema', '')) if isinstance(data, dict) else ''


def _json_kind(
    schema: str, name: str, explain: Callable[[Data], FileSummary], what: str
) -> FileKind:
    def is_one(path: Path) -> bool:
        return begins_with(path, '{') and _schema_of(path) == schema

    def of(path: Path) -> FileSummary:
        data = read_json(path)
        try:
            explanation = explain(data)
            return FileSummary(
                (*explanation.rows, *_provenance_rows(data)),
                {'schema': schema, **explanation.facts},
            )
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            detail = f'{type(error).__name__}: {error}'
            raise ConfigError(f"{path}: is not a complete '{schema}' ({detail})") from None

    return FileKind(name, what, is_one, of)


JSON_KINDS: tuple[FileKind, ...] = (
    _json_kind(
        'otf-error-tables/1',
        'error tables',
        _explain_tables,
        'errors of the motions of a machine; otf predict, compare and simulate read it',
    ),
    _json_kind(
        'otf-error-tables/2',
        'error tables of a machine with rotary axes',
        _explain_axis_tables,
        'errors of the motions and lines of a machine; otf predict, compare, export and simulate '
        'read it',
    ),
    _json_kind(
        'otf-gap/1', 'diagnosis', _explain_gap, 'where and why a run departs from its simulation'
    ),
    _json_kind(
        'otf-plan/1',
        'plan',
        _explain_plan,
        'path, feeds and dwells; otf simulate and the path planner drive it',
    ),
    _json_kind(
        ROTARY_SCHEMA,
        'plan of a machine with rotary axes',
        _explain_rotary_plan,
        'parts to be driven; check, calibrate, diagnose and simulate read it with --path',
    ),
    _json_kind(
        'otf-noise/1',
        'noise',
        _explain_noise,
        'noise of a tracker at rest; otf plan --noise reads it',
    ),
    _json_kind(
        'otf-comparison/1',
        'comparison',
        _explain_comparison,
        'two sources of errors, motion by motion',
    ),
    _json_kind(
        'otf-simulation/1',
        'truth of a simulation',
        _explain_simulation,
        'data that accompany a simulated bag',
    ),
    _json_kind('otf-fleet/1', 'fleet', _explain_fleet, 'many runs, and how each of them ended'),
    _json_kind(
        'otf-manifest/1',
        'manifest',
        _explain_manifest,
        'which files otf wrote into this folder, by their hash',
    ),
)


def _is_other(path: Path) -> bool:
    return begins_with(path, '{') and _schema_of(path).startswith('otf-')


def _explain_other(path: Path) -> FileSummary:
    data = read_json(path)
    rows: Rows = [
        ('schema', data['schema']),
        ('holds', ', '.join(k for k in data if k != 'schema')),
    ]
    return FileSummary(
        (*rows, *_provenance_rows(data)), {'schema': data['schema'], 'keys': list(data)}
    )


OTHER = FileKind(
    'other result', 'a file of otf that has no description', _is_other, _explain_other
)


def _explain_residuals(path: Path) -> FileSummary:
    try:
        with path.open('rb') as raw, np.load(raw, allow_pickle=False) as file:
            shapes = {name: list(file[name].shape) for name in file.files}
            rest = np.linalg.norm(file['residual'], axis=1)
            before = np.linalg.norm(file['deviation'], axis=1)
            runs = int(file['run'].max()) + 1
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError(f'{path}: is not a residuals.npz of otf calibrate ({error})') from None
    rows = (
        ('pieces', f'{len(rest)} of the path, in {runs} run{"s" if runs > 1 else ""}'),
        ('residual', f'{1e6 * rest.mean():.2f} um on average, at most {1e6 * rest.max():.2f} um'),
        ('deviation', f'{1e6 * before.mean():.2f} um on average, before compensation'),
        ('arrays', ', '.join(f'{name} {tuple(shape)}' for name, shape in shapes.items())),
    )
    facts = {
        'pieces': len(rest), 'runs': runs, 'arrays': shapes,
        'mean_residual': float(rest.mean()), 'largest_residual': float(rest.max()),
    }  # fmt: skip
    return FileSummary(rows, facts)


RESIDUALS = FileKind(
    'residuals',
    'what a calibration leaves at every piece of the path',
    lambda path: path.suffix == '.npz' and path.is_file(),
    _explain_residuals,
)


def _is_export(path: Path) -> bool:
    return path.is_file() and is_export(path)


def _explain_export(path: Path) -> FileSummary:
    content = path.read_bytes()
    both = (
        content
        if len(content) <= 2 * MARK_BYTES
        else content[:MARK_BYTES] + b'\n' + content[-MARK_BYTES:]
    )
    text = both.decode('utf-8', errors='replace')
    match = EXPORT_HEAD.search(text)
    if match is None:
        return FileSummary(
            (('export', 'its header has been changed: format and run are unknown'),)
        )
    facts = match.groupdict()
    rows = [
        ('export', f'format {facts["format"]}'),
        ('machine', f'{facts["machine"]}, chain {facts["chain"]}'),
        ('run', f'{facts["run"]}: run_id of the error_tables.json it comes from'),
    ]
    for line in text[match.end() :].splitlines():
        words = line.lstrip(' #;/<!-').removesuffix('-->').strip()
        for start, name in EXPORT_LINES.items():
            if words.startswith(start) and name not in dict(rows):
                rows.append((name, words.removeprefix(start)))
    return FileSummary(tuple(rows), facts)


EXPORT = FileKind(
    'export',
    'error tables in the format of a control or another program, written by otf export',
    _is_export,
    _explain_export,
)


# What people bring: recordings, tables, programs, YAML; and which kind of all a file is.

YAML_SUFFIXES = ('.yaml', '.yml')


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        written_by_otf = (path / MANIFEST).is_file()  # a plan holds its path as an MCAP file
        return (path / 'metadata.yaml').is_file() or (
            not written_by_otf and any(map(is_storage, path.iterdir()))
        )
    return is_storage(path) or path.suffix == '.bag'


def _explain_bag(path: Path) -> FileSummary:
    reading = BagReading(path)
    rows = [('topic', f'{name}, {kind}') for name, kind in sorted(reading.topics.items())]
    facts: dict[str, object] = {'topics': dict(reading.topics)}
    if POINT.name in reading.topics:
        stamps = reading.received().stamp_ns
        seconds = 1e-9 * float(stamps.max() - stamps.min()) if len(stamps) else 0.0
        first = moment(int(stamps.min())) if len(stamps) else None
        rows.append(('samples', f'{len(stamps)} over {seconds:.1f} s'))
        rows += [('first', first)] if first else []
        facts |= {'samples': len(stamps), 'duration_s': seconds, 'first_stamp': first}
    if PATH.name in reading.topics:
        path_driven = path_of(str(path), [reading])
        points = len(path_driven.points)
        rows.append(('path', f'{points} corner points, {path_driven.length:.2f} m'))
        facts |= {'path_points': points, 'path_length': path_driven.length}
    if reading.axis_paths:
        rows.append(_parts_row(reading.axis_paths))
        facts |= {'parts': [p.target for p in reading.axis_paths]}
    rows += [('INCOMPLETE', text) for text in reading.remarks]
    usable = 'see otf check' if POINT.name in reading.topics else f'no: {POINT.name} is missing'
    rows.append(('usable?', usable))
    return FileSummary(tuple(rows), facts)


def _parts_row(parts: Sequence[AxisPath]) -> tuple[str, str]:
    """Parts of a machine with rotary axes."""
    listed = ', '.join(f'{p.target} ({len(p.positions)} corners)' for p in parts)
    return 'parts', f'{len(parts)} of axes {", ".join(parts[0].axes)}: {listed}'


BAG = FileKind(
    'recording', 'samples of a tracker; check, calibrate, diagnose read it', _is_bag, _explain_bag
)


def _is_table(path: Path) -> bool:
    if not is_text(path):
        return False
    try:
        return bool(find_columns(read_table(path), None).point)
    except OtfError:
        return False


def _explain_table(path: Path) -> FileSummary:
    table = read_table(path)
    reading = TextReading(path, rate=None if find_columns(table, None).time else 1.0)
    raw = reading.received()
    rows = [('read as', text) for text in reading.said]
    low, high = raw.xyz.min(axis=0), raw.xyz.max(axis=0)
    rows += [(axis, f'{a:.4f} to {b:.4f} m') for axis, a, b in zip('xyz', low, high, strict=True)]
    facts = {
        'samples': len(raw.xyz),
        'lower': low.tolist(),
        'upper': high.tolist(),
        'left_out': list(map(asdict, reading.left_out)),
    }
    return FileSummary(tuple(rows), facts)


TABLE = FileKind(
    'table of samples',
    'points of a tracker as text; check, calibrate, diagnose read it with --path',
    _is_table,
    _explain_table,
)


def _explain_direct(path: Path) -> FileSummary:
    with path.open(encoding='utf-8-sig', newline='') as file:
        lines = [line for line in file if line.strip() and not line.startswith('#')]
    table = list(csv.DictReader(lines))
    counts = Counter(row['axis'] for row in table)
    columns = [name for name in table[0] if name] if table else []
    rows = (
        ('readings', ', '.join(f'{n} along {axis}' for axis, n in counts.items()) or 'none'),
        ('columns', ', '.join(columns)),
    )
    return FileSummary(rows, {'readings': dict(counts), 'columns': columns})


def _explain_points(path: Path) -> FileSummary:
    points = read_points(path)[0]
    low, high = points.min(axis=0), points.max(axis=0)
    rows = [('points', str(len(points)))]
    ends = zip('xyz', low, high, strict=True)
    rows += [(axis, f'{1e3 * a:g} to {1e3 * b:g} mm') for axis, a, b in ends]
    facts = {'points': len(points), 'lower': low.tolist(), 'upper': high.tolist()}
    return FileSummary(tuple(rows), facts)


DIRECT = FileKind(
    'direct measurement',
    'readings of an instrument along single axes; otf compare reads it',
    lambda path: path.suffix.lower() == '.csv' and begins_with(path, 'axis,run,direction,'),
    _explain_direct,
)
POINTS = FileKind(
    'points',
    'positions x,y,z in m; otf predict, plan --path and simulate --path read it',
    lambda path: path.suffix.lower() == '.csv' and begins_with(path, 'x,y,z'),
    _explain_points,
)


def _explain_program(path: Path) -> FileSummary:
    program = read_program(path)
    points = program.points
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    low, high = points.min(axis=0), points.max(axis=0)
    rows = [
        ('read as', program.said),
        ('path', f'{len(points)} corner points, {length:.2f} m'),
    ]
    ends = zip('XYZ', low, high, strict=True)
    rows += [(axis, f'{1e3 * a:g} to {1e3 * b:g} mm') for axis, a, b in ends]
    facts = {
        'form': program.form, 'path_points': len(points), 'path_length': length,
        'lines': program.lines, 'arcs': program.arcs, 'positions_in': list(program.frames),
        'lower': low.tolist(), 'upper': high.tolist(),
    }  # fmt: skip
    return FileSummary(tuple(rows), facts)


def _explain_axis_positions(path: Path) -> FileSummary:
    try:
        parts = read_axis_paths(path)
    except InputError:  # points of a prediction need not differ
        return FileSummary((('positions', 'without any motion between them'),))
    return FileSummary((_parts_row(parts),), {'parts': [p.target for p in parts]})


AXIS_POSITIONS = FileKind(
    'axis positions',
    'of a machine with rotary axes, m and rad; check, calibrate, diagnose and simulate read them '
    'with --path, predict with --points',
    lambda path: path.suffix.lower() == '.csv' and holds_axis_positions(path),
    _explain_axis_positions,
)
PROGRAM = FileKind(
    'NC program',
    'a path; check, calibrate, diagnose, plan, simulate read it with --path',
    is_program,
    _explain_program,
)


def _is_yaml_of(path: Path, kind: type) -> bool:
    if path.suffix.lower() not in YAML_SUFFIXES or not path.is_file():
        return False
    try:
        return isinstance(read_yaml(path), kind)
    except ConfigError:
        return kind is dict  # whoever reads it as machine.yaml says what is wrong


def _explain_machine(path: Path) -> FileSummary:
    machine = load_machine(path)
    level = 1e6 * machine.tracker.u_range, 1e6 * machine.tracker.u_angle
    rows = [('machine', f'{machine.name}, chain {machine.chain}')]
    for name in machine.axis_names:
        axis = machine.axes[name]
        scale, unit = (math.degrees(1.0), 'degrees') if axis.rotary else (1e3, 'mm')
        rows.append((
            f'axis {name}', f'{scale * axis.min:g} to {scale * axis.max:g} {unit}, a node every '
            f'{scale * axis.table_pitch:g} {unit}',
        ))  # fmt: skip
    offset = ', '.join(f'{1e3 * v:g}' for v in machine.target_offset)
    rows += [
        ('target', f'offset ({offset}) mm'),
        ('tracker', f'{level[0]:g} um along, {level[1]:g} urad across the beam'),
        ('uncertainty', 'declared' if machine.uncertainty else
         'only the noise of the tracker is declared: u will be too small'),
    ]  # fmt: skip
    return FileSummary(tuple(rows), machine.to_dict())


def _explain_effects(path: Path) -> FileSummary:
    data = read_yaml(path)
    rows = []
    for entry in data:
        named = entry if isinstance(entry, dict) else {}
        values = named.get('parameters') or {}
        shown = ', '.join(f'{k} = {v}' for k, v in values.items())
        rows.append((str(named.get('effect', '?')), shown or 'no parameters'))
    return FileSummary(tuple(rows), {'effects': data})


MACHINE = FileKind(
    'machine description',
    'axes, chain, target and tracker of a machine; every verb with --machine reads it',
    lambda path: _is_yaml_of(path, dict),
    _explain_machine,
)
EFFECTS = FileKind(
    'effects',
    'effects with their parameters; otf simulate --effects and calibrate --effects read it',
    lambda path: _is_yaml_of(path, list),
    _explain_effects,
)


KINDS: tuple[FileKind, ...] = (
    BAG,
    FOLDER,
    EXPORT,
    *JSON_KINDS,
    OTHER,
    EFFECTS,
    MACHINE,
    RESIDUALS,
    DIRECT,
    AXIS_POSITIONS,
    POINTS,
    PROGRAM,
    TABLE,
)
"""The first that fits counts."""


def explain(name: str | Path) -> tuple[FileKind, FileSummary]:
    """State what a file is and says.

    Raises
    ------
    ConfigError
        If it cannot be read or is of no kind that otf knows.
    InputError
        If it is a bag that cannot be read.
    """
    path = Path(name)
    try:
        path.stat()
    except OSError as error:
        raise unreadable(path, error) from None
    for kind in KINDS:
        if kind.is_one(path):
            return kind, kind.explain(path)
    known = ', '.join(kind.name for kind in KINDS)
    raise ConfigError(f'{path}: is not a file that otf writes or reads; known: {known}')

# SPDX-License-Identifier: Apache-2.0
"""What otf writes: folders, result files in JSON, residuals, exports."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.errors import ConfigError
from otf_core.exports.base import MARK, NEAR, is_export
from otf_core.files.json_file import read_json
from otf_core.files.manifest import MANIFEST, is_as_listed, listed
from otf_core.info.kind import Explained, Kind, begins
from otf_core.model.expanded import micro_figure, micro_significant, micro_with_expanded
from otf_core.prediction.absorbed import offset_words

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
    'zero because the calibration does not show them: ': 'not seen',
}
"""Beginnings of the further lines of a head, and what they are about."""


def _explain_folder(path: Path) -> Explained:
    entries = listed(path / MANIFEST)
    verb = str(read_json(path / MANIFEST).get('verb'))
    changed = [str(f.relative_to(path)) for f in entries if not is_as_listed(f, entries)]
    names = sorted(f.name for f in entries)
    rows = [('by', f'otf {verb}'), ('files', ', '.join(names))]
    rows += [('CHANGED', f'{name}: is not as it was written') for name in changed]
    facts: dict[str, object] = {'by': verb, 'files': names, 'changed': changed}
    for file in sorted(f for f in entries if f.parent == path and f.suffix == '.json'):
        kind = next((k for k in JSON_KINDS if k.is_one(file)), None)
        if kind is not None:
            found = kind.explain(file)
            rows += [(file.name, kind.what), *((f'  {a}', b) for a, b in found.rows)]
            facts[file.name] = dict(found.facts)
    return Explained(tuple(rows), facts)


FOLDER = Kind(
    'folder of results',
    'what one command wrote, with the hash of every file',
    lambda path: path.is_dir() and bool(listed(path / MANIFEST)),
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


def _explain_tables(data: Data) -> Explained:
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
    return Explained(tuple(rows), facts)


def _explain_gap(data: Data) -> Explained:
    gap = data['gap']
    rows: Rows = [('verdict', f'{data["verdict"]}: {data.get("sentence", "")}')]
    rows.append((
        'gap', f'{gap["before_um"]:.2f} um, with the causes taken off {gap["after_um"]:.2f} um',
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
    return Explained(tuple(rows), {key: data[key] for key in keys})


def _explain_plan(data: Data) -> Explained:
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
    return Explained(tuple(rows), facts)


def _explain_noise(data: Data) -> Explained:
    angle = ' and '.join(f'{1e6 * v:.3f}' for v in data['u_angle'])
    rows = (
        ('noise', f'{1e6 * data["u_range"]:.3f} um along the beam, {angle} urad across (k = 1)'),
        ('from', f'{data["standstills"]} standstills, {data["samples"]} samples'),
    )
    keys = ('u_range', 'u_angle', 'correlation_time', 'standstills', 'samples')
    return Explained(rows, {key: data[key] for key in keys})


def _explain_comparison(data: Data) -> Explained:
    volume = data['volume']
    within = 'no side states an uncertainty'
    if volume['within'] is not None:
        within = f'{100 * volume["within"]:.0f} % of normalised errors at most 1'
    rows = (
        ('of', f'{data["a"]} and {data["b"]}'),
        ('volume', f'differ by {1e6 * volume["mae_difference"]:.2f} um on average'),
        ('within', within),
    )
    return Explained(rows, {'a': data['a'], 'b': data['b'], 'volume': volume})


def _explain_validation(data: Data) -> Explained:
    failed = [r['quantity'] for r in data['rows'] if r.get('passed') is False]
    rows = (
        ('cells', ', '.join(map(str, data['cells']))),
        ('failed', ', '.join(failed) or 'nothing'),
    )
    return Explained(rows, {'cells': data['cells'], 'failed': failed})


def _explain_simulation(data: Data) -> Explained:
    effects = [e['effect'] for e in data['effects']]
    rows = (('seed', str(data['seed'])), ('effects', ', '.join(effects) or 'none'))
    return Explained(rows, {'seed': data['seed'], 'effects': effects})


def _explain_manifest(data: Data) -> Explained:
    files = list(data['sha256'])
    rows = (('by', f'otf {data["verb"]} {data["version"]}'), ('files', ', '.join(files)))
    return Explained(rows, {'by': data['verb'], 'files': files})


def _explain_loop(data: Data) -> Explained:
    keys = ('before_um', 'after_um', 'forecast_um')
    rows = tuple((key.removesuffix('_um'), f'{data[key]:.2f} um') for key in keys)
    return Explained(rows, {key: data[key] for key in keys})


def _explain_fleet(data: Data) -> Explained:
    failed = {name: run['message'] for name, run in data['runs'].items() if run['exit']}
    rows: Rows = [('runs', f'{data["done"]} done, {data["failed"]} failed')]
    rows += [('FAILED', f'{name}: {message}') for name, message in failed.items()]
    return Explained(tuple(rows), {key: data[key] for key in ('done', 'failed', 'runs')})


def _schema_of(path: Path) -> str:
    data = read_json(path)
    return str(data.get('schema', '')) if isinstance(data, dict) else ''


def _json_kind(schema: str, name: str, explain: Callable[[Data], Explained], what: str) -> Kind:
    def is_one(path: Path) -> bool:
        return begins(path, '{') and _schema_of(path) == schema

    def of(path: Path) -> Explained:
        data = read_json(path)
        try:
            found = explain(data)
            return Explained(
                (*found.rows, *_provenance_rows(data)), {'schema': schema, **found.facts}
            )
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            detail = f'{type(error).__name__}: {error}'
            raise ConfigError(f"{path}: is no whole '{schema}' ({detail})") from None

    return Kind(name, what, is_one, of)


JSON_KINDS: tuple[Kind, ...] = (
    _json_kind(
        'otf-error-tables/1',
        'error tables',
        _explain_tables,
        'errors of the motions of a machine; otf predict, compare and simulate read it',
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
        'otf-noise/1',
        'noise',
        _explain_noise,
        'what a tracker shows at rest; otf plan --noise reads it',
    ),
    _json_kind(
        'otf-comparison/1',
        'comparison',
        _explain_comparison,
        'two sources of errors, motion by motion',
    ),
    _json_kind(
        'otf-validation/1',
        'validation',
        _explain_validation,
        "the paper's comparisons on simulated cells",
    ),
    _json_kind(
        'otf-simulation/1',
        'truth of a simulation',
        _explain_simulation,
        'what lies beside a simulated bag',
    ),
    _json_kind(
        'otf-loop/1',
        'loop',
        _explain_loop,
        'a simulated machine measured, compensated and measured again',
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
    return begins(path, '{') and _schema_of(path).startswith('otf-')


def _explain_other(path: Path) -> Explained:
    data = read_json(path)
    rows: Rows = [
        ('schema', data['schema']),
        ('holds', ', '.join(k for k in data if k != 'schema')),
    ]
    return Explained(
        (*rows, *_provenance_rows(data)), {'schema': data['schema'], 'keys': list(data)}
    )


OTHER = Kind(
    'other result', 'a file of otf that has no explanation of its own', _is_other, _explain_other
)


def _explain_residuals(path: Path) -> Explained:
    try:
        with path.open('rb') as raw, np.load(raw, allow_pickle=False) as file:
            shapes = {name: list(file[name].shape) for name in file.files}
            rest = np.linalg.norm(file['residual'], axis=1)
            before = np.linalg.norm(file['deviation'], axis=1)
            runs = int(file['run'].max()) + 1
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError(f'{path}: is no residuals.npz of otf calibrate ({error})') from None
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
    return Explained(rows, facts)


RESIDUALS = Kind(
    'residuals',
    'what a calibration leaves at every piece of the path',
    lambda path: path.suffix == '.npz' and path.is_file(),
    _explain_residuals,
)


def _is_export(path: Path) -> bool:
    return path.is_file() and is_export(path)


def _explain_export(path: Path) -> Explained:
    content = path.read_bytes()
    both = content if len(content) <= 2 * NEAR else content[:NEAR] + b'\n' + content[-NEAR:]
    text = both.decode('utf-8', errors='replace')
    found = EXPORT_HEAD.search(text)
    if found is None:
        return Explained((('export', 'its head has been changed: format and run are not known'),))
    facts = found.groupdict()
    rows = [
        ('export', f'format {facts["format"]}'),
        ('machine', f'{facts["machine"]}, chain {facts["chain"]}'),
        ('run', f'{facts["run"]}: run_id of the error_tables.json it comes from'),
    ]
    for line in text[found.end() :].splitlines():
        said = line.lstrip(' #;/<!-').removesuffix('-->').strip()
        for start, name in EXPORT_LINES.items():
            if said.startswith(start) and name not in dict(rows):
                rows.append((name, said.removeprefix(start)))
    return Explained(tuple(rows), facts)


EXPORT = Kind(
    'export',
    'error tables in the format of a control or another program, written by otf export',
    _is_export,
    _explain_export,
)

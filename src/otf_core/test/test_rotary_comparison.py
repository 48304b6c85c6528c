# SPDX-License-Identifier: Apache-2.0
"""Results of machines with rotary axes side by side: compare, history, fleet."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cli_cells import run
from test_rotary_exports import five_axes

from otf_core.comparison.rotary_axes import compare_rotary
from otf_core.errors import ConfigError
from otf_core.fleet.fleet import JobResult
from otf_core.model.tables import LocationError, MotionTable, tables_to_dict
from otf_core.reports.fleet_report import fleet_page, fleet_rows
from otf_core.sim.cell import random_tables

GAUGE = {'gauge': 'one gauge'}
U = 2e-6


@pytest.fixture(scope='module')
def tables():
    """Tables with an uncertainty, those of EBA not seen."""
    found = random_tables(five_axes(), 5e-5, np.random.default_rng(4))
    motions = {m: replace(t, u=np.full(len(t.value), U)) for m, t in found.motions.items()}
    hidden = motions['EBA']
    motions['EBA'] = replace(hidden, value=0.0 * hidden.value, identifiable=False)
    location = {n: replace(v, u=U) for n, v in found.location.items()}
    return replace(found, motions=motions, location=location)


def written(folder, name, tables, **extra):
    file = folder / f'{name}.json'
    file.write_text(json.dumps(tables_to_dict(tables) | GAUGE | extra))
    return file


def changed(tables, ecc=0.0, x0c=0.0):
    table = tables.motions['ECC']
    motions = {**tables.motions, 'ECC': replace(table, value=table.value + ecc * table.position)}
    own = tables.location['X0C']
    location = {**tables.location, 'X0C': replace(own, value=own.value + x0c)}
    return replace(tables, motions=motions, location=location)


def test_compare_states_differences_of_rotary_motions_and_location_errors(
    tables, tmp_path, capsys
):
    a = written(tmp_path, 'a', tables)
    b = written(tmp_path, 'b', changed(tables, ecc=1e-5, x0c=3e-5))
    assert run('compare', a, b, '--out', tmp_path / 'out') == 0
    shown = capsys.readouterr().out
    ecc, x0c = (next(r for r in shown.splitlines() if r.startswith(n)) for n in ('ECC', 'X0C'))
    assert ecc.split()[1:5] == ['urad', '20.00', '-114.59', 'deg']  # 1e-5 of 2 rad
    assert x0c.split()[1:3] == ['um', '30.00']
    assert 'not compared: EBA' in shown
    data = json.loads((tmp_path / 'out' / 'comparison.json').read_text())
    assert data['location']['X0C']['normalised_error'] == pytest.approx(30 / (2 * 2**0.5 * 2))
    assert data['motions']['ECC']['position_unit'] == 'rad'
    assert data['motions']['EXC']['largest_difference'] == 0.0
    assert data['volume']['mae_difference'] > 1e-6
    assert 'EBA' in data['not_compared']
    assert 'X0C' in (tmp_path / 'out' / 'report.html').read_text()


def test_compare_says_what_cannot_be_compared(tables, tmp_path):
    a = written(tmp_path, 'a', tables)
    other = written(tmp_path, 'other', tables, gauge='another gauge')
    found = compare_rotary(a, other)
    assert not found.motions
    assert len(set(found.not_compared.values())) == 2
    assert found.not_compared['X0C'].startswith('the gauges differ, so that only')
    assert found.not_compared['EBA'] == 'other does not determine it'
    assert found.volume[2] == 0.0  # the volume needs no gauge
    short = {
        m: t if m.axis != 'C' else MotionTable(t.position[2:], t.value[2:], t.u[2:])
        for m, t in tables.motions.items()
    }
    narrow = compare_rotary(a, written(tmp_path, 'narrow', replace(tables, motions=short)))
    assert 'different ranges of C' in narrow.not_compared['X0C']
    assert 'EAA' in narrow.motions


def test_compare_refuses_other_nominal_lines_and_direct_measurements(tables, tmp_path):
    a = written(tmp_path, 'a', tables)
    machine = tables.machine
    moved = replace(machine.axes['C'], centre=(0.0, 0.0, 0.5))
    other = replace(tables, machine=replace(machine, axes={**machine.axes, 'C': moved}))
    with pytest.raises(ConfigError, match='direction or centre of C'):
        compare_rotary(a, written(tmp_path, 'b', other))
    with pytest.raises(ConfigError, match='three linear axes only'):
        compare_rotary(a, tmp_path / 'x.csv')


def test_history_takes_machines_with_rotary_axes(tables, tmp_path):
    a, store = written(tmp_path, 'a', tables), tmp_path / 'store'
    for day in ('01', '02'):
        assert run('history', store, '--add', a, '--at', f'2026-01-{day}') == 0
    assert run('history', store, '--out', tmp_path / 'page') == 0
    names = {f.name for f in (tmp_path / 'page').iterdir()}
    assert {'history.html', 'history.json'} <= names


def test_fleet_shows_location_errors_of_rotary_axes(tables, tmp_path):
    hidden = {**tables.location, 'A0C': LocationError(0.0, 0.0, identifiable=False)}
    tables = replace(tables, location={**hidden, 'X0C': LocationError(1.25e-5, 1e-6)})
    folder = tmp_path / 'one'
    folder.mkdir()
    extra = {
        'failed_gates': [],
        'verdicts': {'machine': {'state': 'fail'}},
        'not_identifiable': ['A0C', 'EBA'],
        'volumetric_error': {'mean': 5e-5, 'max': 1e-4},
    }
    written(folder, 'error_tables', tables, **extra)
    outcomes = {'one': JobResult(0, '', 'x')}
    columns, (row,), shared = fleet_rows('calibrate', tmp_path, outcomes)
    assert 'X0C 12.5 +/- 2.0 um' in row[-1]
    assert 'A0C not known' in row[-1]
    assert row[3].words == 'broken'
    assert 'X0C' in fleet_page('calibrate', outcomes, columns, [row], shared)

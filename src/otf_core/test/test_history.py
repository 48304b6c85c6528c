# SPDX-License-Identifier: Apache-2.0
"""Calibrations of years: store, drift that is there and that is not, next calibration."""

import json
import re
from datetime import datetime, timedelta, timezone
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import error_of

from otf_core.errors import InputError
from otf_core.history.control_chart import MachineStatus, history_of
from otf_core.history.document import machine_history
from otf_core.history.store import add_event, add_run, read_store, series_of
from otf_core.model.chain import displacement, nominal_position
from otf_core.model.evaluation import mean_length, without_rigid_motion
from otf_core.model.machine import load_machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.prediction.calibration_document import load_tables, tables_from_dict, tables_to_dict
from otf_core.reports.history_report import format_history, history_pages


def to_dict(history):
    return machine_history(history).to_dict()


def text_of(history):
    return format_history({'machines': [to_dict(history)]})


START = datetime(2026, 1, 1, tzinfo=timezone.utc)


@pytest.fixture(scope='module')
def found(calibrated):
    """Plain data of a real calibration, and the root of its covariance."""
    values, vectors = np.linalg.eigh(calibrated.covariance_run)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    data = json.loads(json.dumps(calibrated.to_dict()))
    data['provenance'].pop('runs')  # every file stands for a run of its own
    return SimpleNamespace(data=data, root=root)


def moved(data, size):
    """The same tables with EXX stretched by ``size``, m over the range, and C0Y turned, rad."""
    data = json.loads(json.dumps(data))
    table = data['motions']['EXX']
    position = np.array(table['position'])
    table['value'] = (np.array(table['value']) + size * position / np.ptp(position)).tolist()
    data['squareness']['C0Y']['value'] += size
    return data


def written(folder, found, sizes, seed, days=30.0):
    """Calibrations of a machine that changed, each with its own noise; paths of the files."""
    rng, files = np.random.default_rng(seed), []
    folder.mkdir(exist_ok=True)
    for k, size in enumerate(sizes):
        data = moved(found.data, size)
        noise = found.root @ rng.standard_normal(len(found.root))
        for j, name in enumerate(SQUARENESS):
            data['squareness'][name]['value'] += noise[j]
        start = len(SQUARENESS)
        for name in MOTIONS:
            table = data['motions'][name]
            stop = start + len(table['value'])
            if table['identifiable']:
                table['value'] = (np.array(table['value']) + noise[start:stop]).tolist()
            start = stop
        at = (START + timedelta(days=days * k)).isoformat()
        data['provenance']['measured'] = {'first': at, 'last': at}
        files.append(folder / f'{k}.json')
        files[-1].write_text(json.dumps(data))
    return files


def history(folder, found, sizes, seed, limit=None):
    for file in written(folder, found, sizes, seed):
        add_run(folder / 'store', file)
    store = read_store(folder / 'store')
    return history_of(store, store.machines[0], limit)


def test_what_is_added_twice_is_there_once_and_nothing_is_rewritten(found, tmp_path):
    (file,) = written(tmp_path, found, [0.0], 1)
    name, new = add_run(tmp_path / 'store', file)
    (entry,) = (tmp_path / 'store').iterdir()
    before = entry.stat().st_mtime_ns, entry.read_bytes()
    assert new and entry.name.startswith(name)
    assert add_run(tmp_path / 'store', file) == (name, False)
    assert (entry.stat().st_mtime_ns, entry.read_bytes()) == before
    entry.write_bytes(before[1].replace(b'"EXX"', b'"EXX" '))
    with pytest.raises(InputError, match='edited or truncated'):
        read_store(tmp_path / 'store')


def test_a_store_keeps_tables_to_the_last_bit(found, tmp_path):
    (file,) = written(tmp_path, found, [0.0], 2)
    add_run(tmp_path / 'store', file)
    kept = read_store(tmp_path / 'store').runs[0].content.tables
    for name, table in load_tables(file).tables.motions.items():
        np.testing.assert_array_equal(kept.motions[name].value, table.value)


def with_more_known(data, name, slope):
    """The same tables, of which a rotation that was not seen is known: a slope, rad/m."""
    data = json.loads(json.dumps(data))
    table = data['motions'][name]
    assert not table['identifiable']
    table['identifiable'], table['value'] = True, [slope * p for p in table['position']]
    return data


def with_less_driven(data, axis):
    """The same tables but for the first node of an axis."""
    data = json.loads(json.dumps(data))
    for table in data['motions'].values():
        if table['axis'] == axis:
            for key in ('position', 'value', 'u', 'u_run', 'node_identifiable'):
                table[key] = (table[key] or [])[1:]
    del data['covariance'], data['covariance_run']
    return data


@pytest.mark.parametrize('other', [
    lambda data: with_more_known(data, 'EAZ', 2e-4),
    lambda data: with_less_driven(data, 'X'),
    lambda data: with_less_driven(data, 'Z'),
])  # fmt: skip
def test_what_the_convention_takes_out_of_motions_lies_in_squareness(found, tmp_path, other):
    for k, data in enumerate([found.data, other(found.data)]):
        (tmp_path / f'{k}.json').write_text(json.dumps(data))
        add_run(tmp_path / 'store', tmp_path / f'{k}.json', f'2026-03-0{k + 1}')
    series = series_of(read_store(tmp_path / 'store').runs)
    q = series.common.grid
    for run_of, vector in zip(series.runs, series.values, strict=True):
        field = without_rigid_motion(error_of(run_of.content.tables, q), q)
        np.testing.assert_allclose(series.common.field_rows @ vector, field.ravel(), atol=1e-12)


def test_a_steady_machine_shows_no_drift(found, tmp_path):
    judged = [history(tmp_path / f'{s}', found, [0.0] * 5, s) for s in range(11, 17)]
    # each test errs in 5 % of all stores; three false alarms of six have p = 0.002
    assert sum(h.drift.significant for h in judged) <= 2
    changed = [name for h in judged for step in h.steps for name in step.changed]
    tests = sum(len(step.motions) for h in judged for step in h.steps)
    assert len(changed) <= 0.02 * tests
    steady = next(h for h in judged if h.standing is MachineStatus.STEADY)
    assert steady.due.days is None and steady.due.earliest > 0


def test_a_drift_is_named_and_its_due_date_is_that_of_its_rate(found, tmp_path):
    sizes = [3e-6 * k for k in range(5)]
    limit = 5e-6
    h = history(tmp_path, found, sizes, 3, limit)
    assert h.drift.significant
    assert {n for n, c in h.drift.motions.items() if c.significant} == {'EXX', 'C0Y'}
    tables = [tables_from_dict(moved(found.data, s), 'made').tables for s in (0.0, 3e-6)]
    q = h.series.common.grid
    field = error_of(tables[1], q) - error_of(tables[0], q)
    rate = mean_length(without_rigid_motion(field, q)) / 30.0
    assert h.drift.volume == pytest.approx(rate, rel=0.1)
    assert h.due.earliest < limit / rate < h.due.latest
    assert h.due.earliest < h.due.days < h.due.latest
    assert h.standing is MachineStatus.DRIFT and not h.drift.bent and not h.due.withheld


def page_of(*histories):
    return history_pages({'machines': [to_dict(h) for h in histories]})['history.html']


def head_of(*histories):
    """Badge, its class and sentence of a page."""
    found = re.search(
        r'class="badge (\w+)">(.*?)</span>.*?class="verdict">(.*?)</p>',
        page_of(*histories), re.S,
    )  # fmt: skip
    return found.groups()


def test_two_runs_that_differ_are_a_change_and_no_drift(found, tmp_path):
    h = history(tmp_path, found, [0.0, 1e-5], 24)
    assert (
        h.standing is MachineStatus.CHANGED
        and 'cannot distinguish a drift from a jump' in head_of(h)[2]
    )
    assert 'if it continues evenly' in text_of(h)


def test_a_drift_that_speeds_up_has_no_date_and_a_pace_of_its_last_step(found, tmp_path):
    limit = 2e-5
    h = history(tmp_path, found, [0.0, 1e-6, 2e-6, 3.5e-6, 1.2e-5], 25, limit)
    assert h.standing is MachineStatus.BENT and 'EXX' in h.drift.bent
    assert h.due.days is None and h.due.latest is None and h.due.withheld
    # no later than by the last step alone, and that is far sooner than by the line
    assert h.due.earliest <= limit / h.last.volume < 0.6 * limit / h.drift.volume
    assert 'times as fast as before' in head_of(h)[2] and head_of(h)[0] == 'open'
    shown = to_dict(h)['next_calibration']
    assert shown['at'] is None and 'straight line' in shown['withheld']
    assert 'no date' in text_of(h)


def test_after_an_event_drift_begins_anew_and_what_changed_is_said(found, tmp_path):
    sizes = [0.0, 0.0, 2e-5, 2e-5, 2e-5]
    for file in written(tmp_path, found, sizes, 4):
        add_run(tmp_path / 'store', file)
    add_event(tmp_path / 'store', 'collision', '2026-02-20')
    store = read_store(tmp_path / 'store')
    h = history_of(store, store.machines[0])
    step = h.steps[1]
    assert [e.words for e in step.events] == ['collision']
    assert set(step.changed) >= {'EXX', 'C0Y'} and h.reference == 2
    assert not {'EXX', 'C0Y'} & {n for n, c in h.drift.motions.items() if c.significant}


def rotary_tables(machine, growth):
    """Tables of a machine with rotary axes: ECC grows over its range, rad, X0C, m."""
    motions = {}
    for motion in machine.motions:
        axis = machine.axes[motion.axis]
        at = np.linspace(axis.min, axis.max, 5)
        value = growth * np.linspace(0.0, 1.0, 5) if motion == 'ECC' else np.zeros(5)
        motions[motion] = MotionTable(at, value, np.full(5, 1e-7))
    square = {n: ScalarError(0.0, 1e-7) for n in machine.squareness}
    location = {n: ScalarError(growth if n == 'X0C' else 0.0, 1e-7) for n in machine.location}
    return ErrorTables(machine, motions, square, location)


def test_history_of_a_machine_with_rotary_axes_shows_what_drifts(tmp_path):
    machine = load_machine(Path(__file__).parents[3] / 'bags/trunnion/machine.yaml')
    for day, growth in enumerate((0.0, 5e-6, 1e-5), start=1):
        data = tables_to_dict(rotary_tables(machine, growth)) | {'gauge': 'ours'}
        (tmp_path / 'tables.json').write_text(json.dumps(data), encoding='utf-8')
        add_run(tmp_path / 'store', tmp_path / 'tables.json', f'2026-11-0{day}')
    found = history_of(read_store(tmp_path / 'store'), machine.name)
    changed = {n for n, c in found.chart[-1].items() if c.significant}
    assert changed == {'ECC', 'X0C'}
    rate = found.drift.rate[found.series.common.parts['X0C']]
    assert rate == pytest.approx(5e-6, rel=1e-6)
    common = found.series.common
    exact = displacement(rotary_tables(machine, 1e-5), common.grid)
    exact = without_rigid_motion(exact, nominal_position(machine, common.grid)).ravel()
    assert np.allclose(common.field_rows @ found.series.values[-1], exact, atol=1e-15)
    assert 'X0C' in text_of(found)

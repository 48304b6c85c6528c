# SPDX-License-Identifier: Apache-2.0
"""Calibrations of years: store, drift that is there and that is not, next calibration."""

import json
import re
from datetime import datetime, timedelta, timezone
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from cli_cells import run
from core_cells import error_of

from otf_core.errors import ConfigError, InputError
from otf_core.history.control_chart import MachineStatus, history_of
from otf_core.history.document import machine_history
from otf_core.history.store import add_event, add_run, read_store, series_of
from otf_core.model.chain import displacement, nominal_position
from otf_core.model.evaluation import mean_length, without_rigid_motion
from otf_core.model.expanded import micro_significant
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
    return SimpleNamespace(data=json.loads(json.dumps(calibrated.to_dict())), root=root)


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


def test_runs_without_a_date_ask_for_one(found, tmp_path):
    data = dict(found.data)
    del data['provenance']
    (tmp_path / 'a.json').write_text(json.dumps(data))
    with pytest.raises(ConfigError, match='--at DATE'):
        add_run(tmp_path / 'store', tmp_path / 'a.json')
    add_run(tmp_path / 'store', tmp_path / 'a.json', '2026-03-01')
    assert read_store(tmp_path / 'store').runs[0].at.month == 3


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


def test_runs_with_other_targets_are_compared_at_the_latest_or_it_is_said(found, tmp_path):
    known = found.data
    for name in (m for m in MOTIONS if not found.data['motions'][m]['identifiable']):
        known = with_more_known(known, name, 2e-4)
    other = json.loads(json.dumps(known))
    other['machine']['target_offset'][2] -= 0.1
    for data, warns in ((found.data, True), (known, False)):
        store = tmp_path / f'{warns}'
        for k, one in enumerate([data, other]):
            (tmp_path / f'{k}.json').write_text(json.dumps(one))
            add_run(store, tmp_path / f'{k}.json', f'2026-03-0{k + 1}')
        series = series_of(read_store(store).runs)
        assert series.common.machine.target_offset[2] == other['machine']['target_offset'][2]
        assert bool(series.warnings) == warns
        assert ('WARNING' in text_of(history_of(read_store(store), 'small'))) == warns


def test_a_steady_machine_shows_no_drift(found, tmp_path):
    judged = [history(tmp_path / f'{s}', found, [0.0] * 5, s) for s in range(11, 17)]
    # each test errs in 5 % of all stores; three false alarms of six have p = 0.002
    assert sum(h.drift.significant for h in judged) <= 2
    changed = [name for h in judged for step in h.steps for name in step.changed]
    tests = sum(len(step.motions) for h in judged for step in h.steps)
    assert len(changed) <= 0.02 * tests
    steady = next(h for h in judged if h.standing is MachineStatus.STEADY)
    assert steady.due.days is None and steady.due.earliest > 0


def test_what_is_left_about_a_line_that_is_there_is_as_likely_as_stated(found, tmp_path):
    lines = [history(tmp_path / f'{s}', found, [3e-6 * k for k in range(5)], s)
             for s in range(11, 23)]  # fmt: skip
    p = np.array([value for h in lines for value in h.drift.p_line.values()])
    assert len(p) == 204
    # uniform between 0 and 1: mean 0.500 +/- 0.020, 5 % +/- 1.5 % of them below 5 %
    assert abs(np.mean(p) - 0.5) < 0.05 and 0.015 < np.mean(p < 0.05) < 0.085
    assert sum(bool(h.drift.bent) for h in lines) <= 1


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


def test_a_machine_of_which_one_run_follows_an_event_is_not_called_steady(found, tmp_path):
    for file in written(tmp_path, found, [0.0, 6e-6, 1.2e-5, 2e-5, 3.5e-5], 21, days=365.0):
        add_run(tmp_path / 'store', file)
    add_event(tmp_path / 'store', 'X scale replaced', '2029-06-01')
    store = read_store(tmp_path / 'store')
    h = history_of(store, store.machines[0])
    assert h.standing is MachineStatus.CHANGED and h.drift is None and h.due is None
    mood, badge, sentence = head_of(h)
    assert (mood, badge) == ('open', 'changed')
    assert 'EXX by' in sentence and 'after X scale replaced (2029-06-01)' in sentence
    assert 'cannot be assessed yet' in sentence
    assert not re.search('steady', page_of(h), re.I)


def test_where_nothing_changed_but_one_run_follows_an_event_it_is_not_judged(found, tmp_path):
    for file in written(tmp_path, found, [0.0, 0.0], 22):
        add_run(tmp_path / 'store', file)
    alone = history_of(read_store(tmp_path / 'store'), 'small')
    assert alone.standing is MachineStatus.STEADY
    add_event(tmp_path / 'store', 'new spindle', '2026-01-15')
    h = history_of(read_store(tmp_path / 'store'), 'small')
    assert h.standing is MachineStatus.UNJUDGED and 'cannot be assessed yet' in text_of(h)
    add_event(tmp_path / 'store', 'collision', '2026-02-15')
    h = history_of(read_store(tmp_path / 'store'), 'small')
    assert h.standing is MachineStatus.UNJUDGED and h.due is None
    assert 'collision (2026-02-15), and no run since' in head_of(h)[2]
    assert [e['followed'] for e in to_dict(h)['events']] == [True, False]


def test_what_is_not_declared_is_stated_beside_the_drift(found, tmp_path):
    h = history(tmp_path, found, [0.0, 0.0], 22)
    wide = found.data['headline']['u']['mean'] * found.data['headline']['k']
    share = f'up to about {micro_significant(2**0.5 * wide)} in the volume'
    page = page_of(h).replace('\u00a0', ' ').replace('µ', 'u')
    assert share in text_of(h) and share in page
    assert f'U = {micro_significant(wide)}' in page
    assert 'measured with one target offset, (20, -30, -150) mm: ' in text_of(h)
    declared = {**found.data, 'headline': {**found.data['headline'], 'systematic': 'declared'}}
    (tmp_path / 'declared.json').write_text(json.dumps(declared))
    add_run(tmp_path / 'other', tmp_path / 'declared.json', '2026-01-01')
    assert 'typical size' not in text_of(history_of(read_store(tmp_path / 'other'), 'small'))


def test_one_run_alone_is_not_judged(found, tmp_path):
    h = history(tmp_path, found, [0.0], 23)
    assert h.standing is MachineStatus.UNJUDGED and head_of(h)[0] == 'open'
    assert 'one run' in head_of(h)[2]


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


def test_charts_have_dates_events_and_the_reference_and_no_line_across_an_event(found, tmp_path):
    for file in written(tmp_path, found, [0.0, 6e-6, 1.2e-5, 3e-5], 26, days=365.0):
        add_run(tmp_path / 'store', file)
    add_event(tmp_path / 'store', 'moved', '2027-06-01')
    h = history_of(read_store(tmp_path / 'store'), 'small')
    pictures = re.findall(r'<svg.*?</svg>', page_of(h), re.S)
    for picture in pictures:
        texts = re.findall(r'<text[^>]*>(.*?)</text>', picture)
        assert {'2027', '2028'} <= set(texts) and 'days' not in texts
        assert picture.count('<rect class="line ink"') == 1
        assert picture.count('class="line open dash"') == 1
        lines = re.findall(r'class="line after" d="(.*?)"', picture)
        assert [d.count('M') + d.count('L') for d in lines] == [2, 2]
    # what is charted is the change since the first run, also after the event
    assert [c.size > 5e-6 for c in (m['EXX'] for m in h.chart)][2:] == [True, True]


def test_several_machines_share_a_page_that_is_no_better_than_the_worst(found, tmp_path):
    steady = history(tmp_path / 'a', found, [0.0, 0.0], 22)
    alone = history(tmp_path / 'b', found, [0.0], 23)
    assert head_of(steady)[:2] == ('good', 'steady')
    mood, badge, sentence = head_of(steady, alone)
    assert (mood, badge) == ('open', 'not judged')
    assert sentence == 'steady: small; not judged: small.'


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


def test_the_command_fills_a_store_and_writes_a_page_that_needs_nothing(
    found, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / 'r', found, [0.0, 2e-5], 7)
    assert run('history', 'store') == 2
    assert 'creates a store' in capsys.readouterr().err
    assert run('history', 'store', '--add', 'r/0.json', '--add', 'r/1.json',
               '--out', 'page', '--json') == 0  # fmt: skip
    shown = json.loads(capsys.readouterr().out)
    (machine,) = shown['machines']
    assert 'EXX' in machine['steps'][0]['changed']
    assert machine['next_calibration']['not_before'] > machine['runs'][1]['at'][:10]
    page = (tmp_path / 'page/history.html').read_text()
    assert '://' not in page
    pictures = re.findall(r'<svg.*?</svg>', page, re.S)
    assert len(pictures) > 15
    for picture in pictures:
        ElementTree.fromstring(picture)
    assert run('history', 'store', '--name', 'nobody') == 2
    assert run('history', 'store', '--limit', '0') == 2


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

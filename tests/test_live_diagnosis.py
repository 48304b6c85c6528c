# SPDX-License-Identifier: Apache-2.0
"""A live run with backlash: tables first, then its diagnosis, the same as offline on its bag."""

import json
import math
from pathlib import Path

import pytest
from cells import SMALL, write_machine, write_truth
from graph import offline_diagnosis, without_date

from otf_msgs.msg import GapReport
from otf_ros import qos

BACKLASH = 8e-6
"""m, of X"""
TO_AND_FRO = {'passes': 2, 'levels': 2, 'feed': 0.5, 'corner_dwell': 0.1}
"""Parameters of the planner for a short path that shows backlash."""
FASTEST = {'simulated.rate': 100.0, 'time_scale': 40.0}
"""Parameters of the driver for a few samples in a short time."""
PIECE_LENGTH = 0.02
"""m; longer than by default: fewer rows"""


@pytest.fixture
def machine_file(tmp_path):
    """machine.yaml of an even smaller machine."""
    return write_machine(tmp_path, axes=SMALL)


def start_all(graph, machine_file):
    """Start a cell with backlash; returns the calibrator."""
    (graph.folder / 'effects.yaml').write_text(
        f'- effect: backlash\n  parameters: {{B_X: {BACKLASH}}}\n'
    )
    machine = {'machine_file': machine_file}
    graph.start('path_planner', **machine, **TO_AND_FRO)
    given = {'output_directory': graph.folder / 'out', 'piece_length': PIECE_LENGTH}
    calibrator = graph.start('calibrator', **machine, **given, diagnose=True)
    wrong = {'simulated.truth_tables': write_truth(graph.folder, machine_file)}
    wrong['simulated.effects'] = graph.folder / 'effects.yaml'
    graph.start('tracker_driver', **machine, **wrong, **FASTEST)
    return calibrator


def children_of(node):
    """Command lines of the processes that work for a node, whichever thread started them."""
    threads = Path(f'/proc/{node.process.pid}/task').iterdir()
    listed = ' '.join((thread / 'children').read_text() for thread in threads).split()
    commands = [Path(f'/proc/{child}/cmdline').read_text() for child in listed]
    return [command for command in commands if 'otf_calibrator.child' in command]


def assert_same_content(report, gap):
    """The message says what gap.json says, in SI units."""
    um = 1e-6
    assert (report.message, report.verdict) == (gap['sentence'], gap['verdict'])
    assert report.measured == pytest.approx(um * gap['gap']['measured_um'])
    assert report.gap_after == pytest.approx(um * gap['gap']['after_um'])
    interval = [100 * report.shrink_low, 100 * report.shrink_high]
    assert interval == pytest.approx(gap['gap']['shrink_interval_percent'])
    assert report.table_change == pytest.approx(um * gap['table_change_um'])
    for told, cause in zip(report.causes, gap['causes'], strict=True):
        assert (told.effect, list(told.axes)) == (cause['effect'], cause['axes'])
        assert dict(zip(told.parameter, told.value, strict=True)) == cause['parameters']
        assert dict(zip(told.parameter, told.unit, strict=True)) == cause['units']
        u = {n: u for n, u in zip(told.parameter, told.u, strict=True) if not math.isnan(u)}
        assert u == cause['u']
        assert list(told.indistinguishable_from) == cause['indistinguishable_from']
    hidden = zip(report.not_visible, report.not_visible_needs, strict=True)
    assert dict(hidden) == {h['effect']: h['needs'] for h in gap['not_visible']}
    places = {(p.grouping, p.kind, p.label): p for p in report.places}
    where = gap['where'].items()
    rows = [(n[3:], r) for n, rows in where if n.startswith('by_') for r in rows]
    assert len(report.places) == len(rows) > 100
    for grouping, row in rows:
        place = places[grouping, row['kind'], row['label']]
        assert place.measured == pytest.approx(um * row['rms_um'])
        assert place.leg == row.get('leg', -1)
        if place.leg >= 0:
            assert [place.end.x, place.end.y, place.end.z] == row['to']


def test_live_diagnosis_follows_the_tables_and_is_that_of_the_bag(graph, machine_file, tmp_path):
    calibrator = start_all(graph, machine_file)
    answer = graph.trigger('calibrator/diagnose')
    assert not answer.success and 'no run is calibrated yet' in answer.message
    reports = graph.listen(GapReport, 'calibrator/gap_report', qos.RESULT)
    result, _ = graph.wait_for_result()
    assert result.status == result.OK and not reports, 'tables come first'
    graph.wait(lambda: graph.state().diagnosing, 'the start of the diagnosis')
    answer = graph.trigger('calibrator/diagnose')
    assert not answer.success and 'under way' in answer.message
    graph.wait(lambda: reports, 'the report')
    graph.wait(lambda: graph.state().diagnosis_progress == 1.0, 'its state')
    assert not graph.state().diagnosing and 'explained' in graph.state().diagnosis

    report, folder = reports[0], Path(result.output_directory)
    assert (report.status, report.run_id) == (report.OK, result.run_id)
    assert (report.verdict, report.causes[0].effect) == ('explained', 'backlash')
    cause = report.causes[0]
    index = list(cause.parameter).index('B_X')
    assert abs(cause.value[index] - BACKLASH) < 3 * cause.u[index] < 3e-6
    names = {'gap.json', 'gap_report.html', 'effects.yaml', 'report.html'}
    assert {p.name for p in folder.iterdir()} >= names
    live = (folder / 'gap.json').read_text()
    assert_same_content(report, json.loads(live))
    bag = folder / 'samples'
    config = tmp_path / 'config.yaml'
    config.write_text(f'piece_length: {PIECE_LENGTH}')
    option = f'--config={config}'
    again = offline_diagnosis(bag, machine_file, tmp_path / 'offline', option)
    live = without_date(live.encode()).decode()
    # a run is known by the name of its bag, in the answer by the way to it
    live = live.replace(f'"name": "{folder.name}"', f'"name": "{bag.name}"')
    assert live.replace(folder.name, str(bag)) == again

    # reset, the next calibration and the end of the node each end a diagnosis at once
    assert graph.trigger('calibrator/diagnose').success
    graph.wait(lambda: graph.state().diagnosing, 'the start of a diagnosis')
    assert len(children_of(calibrator)) == 2  # one calibrates
    assert graph.trigger('calibrator/calibrate').success
    graph.wait(lambda: 'abandoned' in graph.state().diagnosis, 'its end')
    assert len(children_of(calibrator)) <= 1 and not list(folder.glob('.diagnosis*'))
    graph.wait_for_result(2)
    graph.wait(lambda: graph.state().diagnosing, 'the start of a diagnosis')
    assert graph.trigger('calibrator/reset').success
    graph.wait(lambda: 'abandoned' in graph.state().diagnosis, 'its end')
    assert graph.trigger('calibrator/diagnose').success
    graph.wait(lambda: graph.state().diagnosing, 'the start of a diagnosis')
    graph.stop(calibrator)
    assert len(reports) == 1
    assert not list((tmp_path / 'out').rglob('.diagnosis*'))

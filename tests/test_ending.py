# SPDX-License-Identifier: Apache-2.0
"""Nodes and demo end cleanly: exit code 0, no traceback, no process left."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
import urllib.request
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from cells import FAST, SHORT, SMALL, write_machine
from graph import PATIENCE

from otf_bringup import demo as demonstration
from otf_bringup import view
from otf_bringup.processes import module_of
from otf_core.model.machine import load_machine
from otf_core.prediction.calibration_document import tables_to_dict
from otf_core.sim.cell import random_tables
from otf_msgs.msg import CalibrationResult, GapReport


def test_all_nodes_end_with_code_0_in_the_middle_of_a_run(graph, machine_file):
    graph.start('path_planner', machine_file=machine_file, **SHORT)
    graph.start('calibrator', machine_file=machine_file, output_directory=graph.folder / 'out')
    graph.start('tracker_driver', machine_file=machine_file, **{**FAST, 'time_scale': 1.0})
    graph.wait(lambda: graph.state() and graph.state().samples > 100, 'samples')
    nodes = list(graph.nodes)
    for node in nodes:
        graph.nodes.remove(node)
        node.interrupt(signal.SIGTERM)  # and with SIGINT after each test of a graph
    for node in nodes:
        assert node.wait(timeout=PATIENCE) == 0, node.last_lines(40)
        assert 'Traceback' not in node.last_lines(1000)


def test_calibrator_ends_with_code_0_during_a_calibration(graph, machine_file):
    graph.start('path_planner', machine_file=machine_file, **SHORT)
    out = graph.folder / 'out'
    node = graph.start('calibrator', machine_file=machine_file, output_directory=out)
    graph.start('tracker_driver', machine_file=machine_file, **FAST)
    graph.wait(lambda: graph.state() and graph.state().name in ('ALIGNING', 'SOLVING'), 'work')
    graph.stop(node)
    for folder in out.glob('2*'):
        assert (folder / 'error_tables.json').exists() or not list(folder.iterdir())


def test_second_signal_at_the_very_end_leaves_the_exit_code(tmp_path):
    (tmp_path / 'ended.py').write_text('main = lambda: 3')
    again = 'atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))'
    text = f'import atexit, os, signal; from otf_ros import entry; {again}; '
    command = [sys.executable, '-c', text + 'raise SystemExit(entry.main("ended"))']
    paths = os.pathsep.join([str(tmp_path), os.environ.get('PYTHONPATH', '')])
    environment = {**os.environ, 'PYTHONPATH': paths}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (3, '')


INTERRUPTED = 'import os, signal, time; os.kill(os.getpid(), signal.SIGINT); time.sleep(60.0)'


def interrupted_while_it_loads(folder, module):
    """What comes of a process that gets Ctrl-C as soon as it imports another package."""
    for name in ('rclpy', 'numpy'):
        (folder / f'{name}.py').write_text(INTERRUPTED)
    paths = os.pathsep.join([str(folder), os.environ.get('PYTHONPATH', '')])
    command, environment = [sys.executable, '-m', module], {**os.environ, 'PYTHONPATH': paths}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


NAMES = ['path_planner', 'tracker_driver', 'calibrator', 'compensator', 'viewer', 'page']


@pytest.mark.parametrize('name', NAMES)
def test_ctrl_c_while_a_node_loads_ends_it_with_code_0(tmp_path, name):
    assert interrupted_while_it_loads(tmp_path, module_of(name)) == (0, '')


def test_ctrl_c_while_the_demo_loads_ends_it_as_later(tmp_path):
    assert interrupted_while_it_loads(tmp_path, 'otf_bringup') == (130, '')


STUCK = """
import os, signal, time
from rclpy.node import Node
from otf_ros import app

class Stuck(Node):
    def __init__(self):
        super().__init__('stuck')
        os.kill(os.getpid(), signal.SIGINT)
    def destroy_node(self):
        time.sleep(600.0)

app.LONGEST_END = 0.5
raise SystemExit(app.run(Stuck))
"""


def test_node_that_hangs_at_its_end_ends_and_says_where():
    command = [sys.executable, '-c', STUCK]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert done.returncode == 1 and 'in destroy_node' in done.stderr


def children_of(pid):
    """Processes started by a process, by their command lines."""
    listed = Path(f'/proc/{pid}/task/{pid}/children').read_text().split()
    return [int(child) for child in listed]


def start_demo(folder, *arguments):
    command = [sys.executable, '-m', 'otf_bringup', '--out', str(folder), *arguments]
    text = {'stdout': subprocess.PIPE, 'stderr': subprocess.STDOUT, 'text': True}
    return subprocess.Popen(command, **text)


def wait_for_text(process, part):
    """Read the output up to a line with this part."""
    for line in process.stdout:
        if part in line:
            return
    raise AssertionError(f'ended with code {process.wait()} without {part!r}')


def gone(pids):
    """Wait until no such process is left."""
    deadline = time.monotonic() + PATIENCE
    while any(Path(f'/proc/{pid}').exists() for pid in pids):
        assert time.monotonic() < deadline, 'processes are left'
        time.sleep(0.05)
    return True


def test_interrupted_demo_leaves_no_process(tmp_path):
    with start_demo(tmp_path) as demo:
        wait_for_text(demo, 'BUFFERING')
        children = children_of(demo.pid)
        assert len(children) == 3
        demo.send_signal(signal.SIGINT)
        assert 'Traceback' not in demo.stdout.read()
        assert demo.wait(PATIENCE) == 130
    assert gone(children)


def test_demo_tells_which_node_failed(tmp_path):
    with start_demo(tmp_path) as demo:
        wait_for_text(demo, 'BUFFERING')
        children = children_of(demo.pid)
        names = {pid: Path(f'/proc/{pid}/cmdline').read_text() for pid in children}
        driver = next(pid for pid, name in names.items() if 'tracker_driver' in name)
        os.kill(driver, signal.SIGKILL)
        said = demo.stdout.read()
        assert demo.wait(PATIENCE) == 1
        assert 'tracker_driver ended with code -9' in said and 'Traceback' not in said
    assert gone(children)


ENDS_WITH = [
    'expected after compensation',
    'compensated: mean',
    'Report: ',
    'Took',
]
"""What a demo prints of tables and errors on a grid, in this order."""


def test_demo_ends_with_tables_and_its_page_stays_until_a_key(tmp_path):
    machine_file = write_machine(tmp_path, axes=SMALL)
    command = [sys.executable, '-m', 'otf_bringup', '--out', str(tmp_path / 'demo')]
    command += ['--machine', str(machine_file), '--seed', '2', '--view']
    ours, theirs = pty.openpty()
    plain = {k: v for k, v in os.environ.items() if k not in ('DISPLAY', 'WAYLAND_DISPLAY')}
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=plain) as demo:
        os.close(theirs)
        said = ''
        while 'Enter ends it' not in said:
            said += os.read(ours, 4096).decode(errors='replace')
        address = re.search(r'the report at (http://\S+)/report.html', said)[1]
        time.sleep(2 * view.TO_READ)  # it does not end by itself
        ended, found = demo.poll(), {}
        for place in ('/', '/report.html', '/state.json'):
            with suppress(OSError), urllib.request.urlopen(address + place, timeout=10) as answer:
                found[place] = answer.read()
        os.write(ours, b'\n')
        assert demo.wait(PATIENCE) == 0, said
        said += os.read(ours, 4096).decode(errors='replace')
    assert sorted(ENDS_WITH, key=said.find) == ENDS_WITH and ENDS_WITH[0] in said, said
    assert (tmp_path / 'demo/calibrations/latest/error_tables.json').exists()
    assert ended is None and b'"report":"report.html"' in found['/state.json']
    assert b'</html>' in found['/'] and b'</html>' in found['/report.html']
    os.close(ours)


def test_page_of_the_demo_is_not_waited_for_where_nobody_can_press_a_key(monkeypatch, capsys):
    monkeypatch.setattr(view, 'TO_READ', 0.0)
    view.keep_open('http://nowhere/')
    assert capsys.readouterr().out == ''


def test_demo_states_samples_that_were_lost_in_words(tmp_path, capsys):
    machine = load_machine(write_machine(tmp_path, axes=SMALL))
    tables = random_tables(machine, 1e-5, np.random.default_rng(1))
    sizes = {'mean': 0.5e-6, 'p95': 0.8e-6, 'max': 1e-6}
    head = {'u': sizes, 'u_run': sizes, 'k': 2.0, 'systematic': 'declared', 'typical_for': [],
            'label': '', 'points': 8, 'error': sizes, 'u_of_largest': 1e-6, 'contributions': {},
            'sentences': []}  # fmt: skip
    (tmp_path / 'error_tables.json').write_text(
        json.dumps({**tables_to_dict(tables), 'headline': head})
    )
    for lost, stated in ((0, False), (56, True)):
        found = CalibrationResult(output_directory=str(tmp_path), samples=944, samples_lost=lost)
        demonstration._report(tables, found)
        assert ('56 samples (5.6 %) were lost' in capsys.readouterr().out) == stated


def test_demo_states_what_a_diagnosis_gave(capsys):
    said = {'verdict': 'none', 'message': 'No gap.', 'output_directory': 'run'}
    demonstration._report_gap(GapReport(status=GapReport.OK, **said))
    demonstration._report_gap(GapReport(status=GapReport.INPUT_UNUSABLE, message='hardly moved'))
    out = capsys.readouterr().out
    assert 'Diagnosis: none. No gap.' in out and 'Report: run/gap_report.html' in out
    assert 'Diagnosis failed: hardly moved' in out


def test_demo_refuses_a_wrong_machine(tmp_path):
    with start_demo(tmp_path, '--machine', str(tmp_path / 'none.yaml')) as demo:
        said = demo.stdout.read()
        assert demo.wait(PATIENCE) == 2
    assert 'none.yaml' in said and 'Traceback' not in said

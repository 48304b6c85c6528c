# SPDX-License-Identifier: Apache-2.0
"""Bad input: one message with what, where and what to do; the exit code; nothing half-written."""

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from command import COMMAND, HERE, otf, read, refused, with_variables
from golden import RECORDINGS
from stated import MACHINE

import otf_core

RUN = RECORDINGS['two-targets']
BAG, GOOD = RUN.bags[0], RUN.machines[0]


def calibrate(folder, bag=BAG, machine=GOOD, *options):
    """Calibrate into ``folder/out``."""
    return otf('calibrate', bag, '--machine', machine, '--out', folder / 'out', *options)


def changed(folder, change):
    """machine.yaml with a change of its content."""
    content = json.loads(json.dumps(MACHINE))
    change(content)
    file = folder / 'wrong.yaml'
    file.write_text(json.dumps(content))
    return file


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        (lambda m: m.update(feed=1), ['feed', 'unknown']),
        (lambda m: m.pop('tracker'), ['tracker', 'missing']),
        (lambda m: m['axes']['X'].update(max=300.0), ['axes.*X.*max', 'mm']),
        (lambda m: m['axes']['X'].update(max=0.0), ['axes.*X']),
        (lambda m: m['tracker'].update(u_range=0.5), ['u_range', 'um|µm']),
        (lambda m: m['tracker'].update(u_angle='two'), ['u_angle', 'two']),
        (lambda m: m.update(chain='w-b-X-Y-Q-t'), ['chain', 'Q']),
        (lambda m: m.update(target_offset=[0, 0]), ['target_offset', '3']),
    ],
    ids=['unknown', 'missing', 'mm', 'empty range', 'unit', 'text', 'chain', 'shape'],
)
def test_machine_file_is_refused_with_the_key(tmp_path, change, words):
    done = calibrate(tmp_path, BAG, changed(tmp_path, change))
    refused(done, 2, 'wrong.yaml', *words, written=[tmp_path / 'out'])


@pytest.mark.parametrize(
    ('words', 'parts'),
    [
        (['calibrat'], ['calibrat', 'calibrate']),
        (['calibrate', BAG, '--machine', GOOD], ['--out']),
        (['calibrate', BAG, '--machine', GOOD, '--out', 'o', '--metod', 'otf'], ['--method']),
        (['calibrate', BAG, '--machine', GOOD, '--out', 'o', '--method', 'x'], ['standstill']),
        (['calibrate', BAG, '--machine', 'no.yaml', '--out', 'o'], ['no.yaml']),
        (['calibrate', BAG, BAG, '--machine', GOOD, '--out', 'o'], ['run1']),
        (['export', 'no', '--format', 'isg', '--out', 'o'], ['no']),
        (
            ['predict', '--tables', GOOD, '--points', 'no.csv', '--out', 'o'],
            ['machine.yaml|no.csv'],
        ),
    ],
    ids=['verb', 'no --out', 'option', 'choice', 'machine', 'same bag twice', 'export', 'predict'],
)
def test_wrong_usage_is_named_with_what_is_possible(tmp_path, words, parts):
    done = otf(*words, folder=tmp_path)
    assert done.code in (2, 3)
    refused(done, done.code, *parts, written=[tmp_path / 'o'])


def test_recording_that_is_not_there_is_named(tmp_path):
    done = calibrate(tmp_path, tmp_path / 'nowhere')
    refused(done, done.code, 'nowhere', written=[tmp_path / 'out'])
    assert done.code in (2, 3)


def test_empty_folder_is_no_recording(tmp_path):
    (tmp_path / 'empty').mkdir()
    refused(calibrate(tmp_path, tmp_path / 'empty'), 3, 'empty', written=[tmp_path / 'out'])


def test_file_that_is_no_bag_is_refused(tmp_path):
    (tmp_path / 'noise.mcap').write_bytes(os.urandom(4000))
    refused(calibrate(tmp_path, tmp_path / 'noise.mcap'), 3, 'noise.mcap')


def rewritten(folder, change):
    """The recording with changed samples or path, as a new bag."""
    recording = otf_core.read_bag(BAG, otf_core.load_machine(GOOD))
    samples, path = change(recording.samples, recording.path)
    bag = folder / 'changed'
    otf_core.write_bag(otf_core.Recording(samples, path, recording.machine), bag)
    return bag


def test_cut_bag_is_read_to_its_last_chunk_and_says_what_is_missing(tmp_path):
    large = RECORDINGS['y-carries-the-table']  # several chunks
    (file,) = Path(large.bags[0]).glob('*.mcap')
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(file.read_bytes()[: int(0.6 * file.stat().st_size)])
    done = otf('check', cut, '--machine', large.machines[0], '--json')
    assert done.code == 3  # 40 % of the path are missing
    found = done.document
    assert not found['usable'] and 0.3 < found['coverage'] < 0.75
    assert 'cut.mcap' in done.err


def test_samples_that_are_no_numbers_are_left_out_and_counted(tmp_path):
    def spoil(samples, path):
        xyz = samples.xyz.copy()
        xyz[100:120] = np.nan
        return otf_core.Samples(samples.stamp_ns, xyz), path

    try:
        bag = rewritten(tmp_path, spoil)
    except otf_core.OtfError as error:  # refused already where they are written
        assert '100' in str(error) or 'finite' in str(error)
        return
    done = otf('check', bag, '--machine', GOOD, '--json')
    assert done.code in (0, 3)
    assert '20' in done.said


def test_path_beyond_an_axis_is_refused_with_the_axis(tmp_path):
    shorter = changed(tmp_path, lambda m: m['axes']['X'].update(max=0.2))
    done = calibrate(tmp_path, BAG, shorter)
    assert done.code in (2, 3)
    refused(done, done.code, 'X', '0.2|200', written=[tmp_path / 'out'])


def test_path_in_millimetres_is_refused_with_the_unit(tmp_path):
    points = otf_core.read_bag(BAG, otf_core.load_machine(GOOD)).path.points * 1e3
    rows = '\n'.join(','.join(map(repr, row)) for row in points.tolist())
    (tmp_path / 'path.csv').write_text(f'x,y,z\n{rows}\n')
    done = calibrate(tmp_path, BAG, GOOD, '--path', tmp_path / 'path.csv')
    assert done.code in (2, 3)
    refused(done, done.code, 'mm', written=[tmp_path / 'out'])


def test_tables_with_a_missing_or_broken_field_are_refused(tables_file, tmp_path):
    file = tables_file()
    (tmp_path / 'p.csv').write_text('x,y,z\n0.1,0.1,-0.1\n')
    words = ('predict', '--tables', file, '--points', tmp_path / 'p.csv', '--out')
    for key, value in (('value', [0.0, float('nan'), 0.0]), ('position', [0.0, 0.15])):
        content = json.loads(tables_file().read_text())
        content['motions']['EYX'][key] = value
        file.write_text(json.dumps(content))
        done = otf(*words, tmp_path / 'e.csv')
        assert done.code in (2, 3)
        refused(done, done.code, 'EYX', written=[tmp_path / 'e.csv'])
    file.write_text(file.read_text()[:200])
    refused(otf(*words, tmp_path / 'e.csv'), 2, 'tables.json', written=[tmp_path / 'e.csv'])


@pytest.mark.parametrize('written', ['backlash'])
def test_results_are_replaced_only_when_asked_and_never_the_files_of_others(
    result_of, tmp_path, written
):
    out = tmp_path / 'out'
    shutil.copytree(result_of(written).folder, out)
    before = {path: path.read_bytes() for path in out.iterdir()}
    refused(calibrate(tmp_path), 2, '--overwrite')
    assert {path: path.read_bytes() for path in out.iterdir()} == before
    other = tmp_path / 'mine'
    other.mkdir()
    (other / 'letter.txt').write_text('mine')
    words = ('calibrate', BAG, '--machine', GOOD, '--out', other, '--overwrite')
    done = otf(*words)
    assert (other / 'letter.txt').read_text() == 'mine'
    assert done.code in (0, 2)


def test_killed_command_leaves_nothing_under_the_final_name(tmp_path):
    words = [*COMMAND, 'calibrate', BAG, '--machine', GOOD, '--out', str(tmp_path / 'out')]
    running = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env=with_variables({}))
    time.sleep(1.5)
    running.send_signal(signal.SIGKILL)
    running.communicate()
    assert running.returncode == -signal.SIGKILL
    assert not (tmp_path / 'out').exists()


def test_interrupted_command_says_so_and_leaves_nothing(tmp_path):
    words = [*COMMAND, 'diagnose', BAG, '--machine', GOOD, '--out', str(tmp_path / 'out')]
    running = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env=with_variables({}))
    while 'numpy' not in Path(f'/proc/{running.pid}/maps').read_text():
        time.sleep(0.05)
    time.sleep(1.0)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert running.returncode in (130, -signal.SIGINT), said
    assert 'Traceback' not in said and list(tmp_path.iterdir()) == []


def test_output_that_cannot_be_written_is_named(tables_file, tmp_path):
    (tmp_path / 'file').write_text('')
    words = ('compare', tables_file(), tables_file(), '--out', tmp_path / 'file/out')
    done = otf(*words)
    assert done.code in (2, 3)
    refused(done, done.code, 'file')


def test_measurement_that_fails_a_gate_ends_with_4_and_is_written(tmp_path):
    def half(samples, path):
        keep = len(samples) // 2
        return otf_core.Samples(samples.stamp_ns[:keep], samples.xyz[:keep]), path

    done = calibrate(tmp_path, rewritten(tmp_path, half))
    assert done.code == 4
    document = read(tmp_path / 'out/error_tables.json')
    assert document['failed_gates'] and not document['verdicts']['measurement']['good']


@pytest.mark.parametrize(('limit', 'code'), [(500e-6, 0), (5e-6, 5)])
def test_limits_of_the_machine_are_a_verdict_of_their_own(tmp_path, limit, code):
    machine = tmp_path / 'limits.yaml'
    text = Path(GOOD).read_text() + f'limits: {{volumetric_error: {limit}}}\n'
    machine.write_text(text)
    done = calibrate(tmp_path, BAG, machine)
    assert done.code == code, done.said
    verdicts = read(tmp_path / 'out/error_tables.json')['verdicts']
    assert verdicts['measurement']['good']
    assert verdicts['machine']['state'] == {0: 'pass', 5: 'fail'}[code]


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('{levls: 2}', ['config.yaml', 'levls', 'levels']),
        ('{piece_length: 0.004}', ['config.yaml', 'piece_length']),
        ('{levels: two}', ['config.yaml', 'levels', 'two']),
        ('{levels: 20}', ['config.yaml', 'levels', '20']),
        ('levels 2', ['config.yaml']),
    ],
    ids=['unknown', 'of another verb', 'text', 'range', 'no mapping'],
)
def test_config_is_refused_with_file_and_key(machine_file, tmp_path, text, words):
    (tmp_path / 'config.yaml').write_text(text)
    given = ('--machine', machine_file, '--config', tmp_path / 'config.yaml')
    done = otf('plan', *given, '--out', tmp_path / 'plan')
    refused(done, 2, *words, written=[tmp_path / 'plan'])


def test_config_sets_what_no_option_does(machine_file, tmp_path):
    (tmp_path / 'config.yaml').write_text('{levels: 2, passes: 1, end_dwell: 1.5}')
    given = ('--machine', machine_file, '--config', tmp_path / 'config.yaml')
    assert otf('plan', *given, '--out', tmp_path / 'short').code == 0
    assert otf('plan', *given[:2], '--out', tmp_path / 'long').code == 0
    short, long = (
        len((tmp_path / n / 'path.csv').read_text().splitlines()) for n in ('short', 'long')
    )
    assert short < long / 2


PLANES = HERE / 'recordings' / 'planes'
HIDDEN = {'one-plane': ('Z', ('B0Z', 'A0Z')), 'undriven': ('Y', ('C0Y', 'A0Z'))}
"""Recording: the axis that stands still, and what is not determined for that reason."""


@pytest.mark.parametrize('name', HIDDEN)
def test_squareness_that_is_not_determined_is_named_and_the_rest_is_written(tmp_path, name):
    axis, squareness = HIDDEN[name]
    done = calibrate(tmp_path, PLANES / name, PLANES / 'machine.yaml')
    assert done.code in (0, 4)
    document = read(tmp_path / 'out/error_tables.json')
    for square in squareness:
        own = document['squareness'][square]
        assert own.get('value') in (None, 0.0) or own.get('identifiable') is False
    for motion, own in document['motions'].items():
        if motion[2] == axis:
            assert not own['identifiable'] and not any(own['value'])
    assert document['motions']['EBX' if axis == 'Y' else 'ECX']['identifiable']
    page = (tmp_path / 'out/report.html').read_text(encoding='utf-8')
    assert all(square in page for square in squareness)

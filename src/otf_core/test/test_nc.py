# SPDX-License-Identifier: Apache-2.0
"""NC programs word by word for a small plan, rounding, and the real LinuxCNC interpreter."""

import re
import shutil
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import on_increments, program, small_plan, some_machine

from otf_core.model.plan import Plan
from otf_core.planning.nc import DIALECTS
from otf_core.planning.nc.dialect import plain

POINTS = np.array([[0.0, 0.0, -0.1], [0.1, 0.05, -0.1], [0.1, 0.05, 0.0125]])


def little(points=POINTS, feed=(0.25, 0.05), dwell=(2.0, 0.25, 2.0)):
    return Plan.along(points, np.array(feed), np.array(dwell))


def test_rounding_stays_inside_the_axis_ranges():
    low, high = np.array([0.0, 0.0, -0.1000004]), np.array([0.1000006, 0.05, 0.0125])
    machine = some_machine(ranges=list(zip(low, high, strict=True)))
    plan = on_increments(machine, little(np.array([low, high, low])))
    assert np.all(plan.path.points >= low - 1e-12)
    assert np.all(plan.path.points <= high + 1e-12)
    assert plan.path.points[1, 0] == 0.1


def test_repeated_point_is_a_dwell_and_no_move():
    points = np.array([POINTS[0], POINTS[1], POINTS[1]])
    text = program(DIALECTS['linuxcnc'], little(points), [])
    assert text.count('G53 G1 X100.000 Y50.000 Z-100.000') == 1
    assert 'G4 P2.250' in text.splitlines()


@pytest.mark.parametrize(
    ('text', 'said'),
    [('mill (new); 5%', 'mill -new-- 5-'), ('Fräse µ', 'Fr?se ?'), ('a\nb  c', 'a b c')],
)
def test_comments_hold_nothing_that_ends_or_breaks_them(text, said):
    assert plain(text) == said


def run(command, **options):
    return subprocess.run(
        command, capture_output=True, text=True, timeout=180, check=False, **options
    )


def fetched_interpreter(folder):
    """Unpack the interpreter from Debian's package; a sentence if that is not possible."""
    if not (shutil.which('apt-get') and shutil.which('dpkg-deb')):
        return 'no rs274 here, and no apt-get and dpkg-deb to fetch it'
    asked = run(['apt-cache', 'depends', 'linuxcnc-uspace'])
    packages = [
        'linuxcnc-uspace',
        *sorted(set(re.findall(r'libboost-python[\d.]+', asked.stdout))),
    ]
    quick = ['-o', 'Acquire::Retries=0', '-o', 'Acquire::http::Timeout=20']
    got = run(['apt-get', 'download', *quick, *packages], cwd=folder)
    if got.returncode:
        return f'no rs274 here, and apt-get download gave: {got.stderr.strip()[-200:]}'
    for package in folder.glob('*.deb'):
        run(['dpkg-deb', '-x', str(package), str(folder / 'root')])
    return None


@pytest.fixture(scope='session')
def rs274(tmp_path_factory):
    """Run the interpreter of LinuxCNC on a program: gives return code and canonical moves."""
    folder = tmp_path_factory.mktemp('linuxcnc')
    command, environment = shutil.which('rs274'), None
    if command is None:
        try:
            trouble = fetched_interpreter(folder)
        except subprocess.TimeoutExpired:
            trouble = 'no rs274 here, and the package archive does not answer'
        if trouble:
            pytest.skip(trouble)
        root = folder / 'root'
        command = str(root / 'usr/bin/rs274')
        libraries = {str(p.parent) for p in root.rglob('*.so*')}
        environment = {'LD_LIBRARY_PATH': ':'.join(sorted(libraries)), 'PATH': '/usr/bin:/bin'}
    (folder / 'm.ini').write_text('[TRAJ]\nLINEAR_UNITS = mm\n')
    (folder / 'tool.tbl').write_text('')

    def interpret(text):
        (folder / 'p.ngc').write_text(text)
        options = ['-g', '-n', '2', '-i', 'm.ini', '-t', 'tool.tbl', '-v', 'x.var', 'p.ngc']
        done = run([command, *options], cwd=folder, env=environment)
        moves = re.findall(r'N\.+ (\w+)\((.*)\)$', done.stdout, flags=re.M)
        return SimpleNamespace(code=done.returncode, moves=moves, error=done.stderr)

    probe = interpret('G21\nM2\n')
    if probe.code:
        pytest.skip(f'rs274 does not start here: {probe.error.strip()[-200:]}')
    return interpret


def numbers(text):
    return [float(v) for v in text.split(',')]


def test_linuxcnc_interpreter_drives_the_plan(rs274):
    machine = some_machine()
    plan = on_increments(machine, small_plan(machine, passes=2))
    done = rs274(program(DIALECTS['linuxcnc'], plan, ['OTF path; (test) %']))
    assert done.code == 0, done.error
    names = [name for name, _ in done.moves]
    assert ('SET_MOTION_CONTROL_MODE', 'CANON_EXACT_STOP') in done.moves
    assert 'PROGRAM_END' in names
    assert 'STRAIGHT_TRAVERSE' not in names  # nothing at rapid
    stop = names.index('PROGRAM_STOP')
    place, feed = None, None
    points, feeds, dwells = [], [], []
    for k, (name, text) in enumerate(done.moves):
        if name == 'STRAIGHT_FEED':
            place = numbers(text)[:3]
            if k > stop:
                points.append(place)
                feeds.append(feed)
        elif name == 'SET_FEED_RATE':
            feed = numbers(text)[0]
        elif name == 'DWELL' and k > stop:
            dwells.append(numbers(text)[0])
        if k == stop:
            points.append(place)
    np.testing.assert_allclose(points, 1e3 * plan.path.points, atol=1e-4)
    np.testing.assert_allclose(feeds, np.rint(6e4 * plan.feed))
    np.testing.assert_allclose(dwells, plan.dwell)

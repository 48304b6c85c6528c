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
EXPECTED = {
    'sinumerik': """\
; HEAD -1-
; MACHINE COORDINATES - SUPA, D0
G17 G40 G710 G90 G94
G64 G601
D0
; APPROACH: Z TO THE TOP OF THE PART, THEN TO ITS START
G9 SUPA G1 Z12.500 F3000
G9 SUPA G1 X0.000 Y0.000 F3000
G9 SUPA G1 Z-100.000 F3000
; part 1: put the reflector at tool, lock the beam, record
MSG("part 1: put the reflector at tool, lock the beam, record")
M0
G4 F2.000
G9 SUPA G1 X100.000 Y50.000 Z-100.000 F15000
G4 F0.250
G9 SUPA G1 X100.000 Y50.000 Z12.500 F3000
G4 F2.000
G94
M30
""",
    'fanuc': """\
%
O1001 (OTF PATH)
(HEAD -1-)
(SET G54 AND THE EXTERNAL OFFSET TO ZERO: G54 MUST EQUAL MACHINE COORD.)
G21 G90 G94 G17 G40 G49 G80
G54
G64
(APPROACH: Z TO THE TOP OF THE PART, THEN TO ITS START)
G09 G90 G01 Z12.500 F3000.
G09 G90 G01 X0.000 Y0.000 F3000.
G09 G90 G01 Z-100.000 F3000.
(PART 1: PUT THE REFLECTOR AT TOOL, LOCK THE BEAM, RECORD)
M00
G04 X2.000
G09 G90 G01 X100.000 Y50.000 Z-100.000 F15000.
G04 X0.250
G09 G90 G01 X100.000 Y50.000 Z12.500 F3000.
G04 X2.000
G94 G90 G49
M30
%
""",
    'heidenhain': """\
0 BEGIN PGM OTFPATH_1 MM
1 ; HEAD -1-
2 ; POSITIONS REFER TO THE MACHINE DATUM - M91 - CALL TOOL 0 BEFORE
3 ; APPROACH: Z TO THE TOP OF THE PART, THEN TO ITS START
4 L Z+12.500 R0 F3000 M91
5 CYCL DEF 9.0 DWELL TIME
6 CYCL DEF 9.1 DWELL 0.100
7 L X+0.000 Y+0.000 R0 F3000 M91
8 CYCL DEF 9.0 DWELL TIME
9 CYCL DEF 9.1 DWELL 0.100
10 L Z-100.000 R0 F3000 M91
11 CYCL DEF 9.0 DWELL TIME
12 CYCL DEF 9.1 DWELL 0.100
13 ; part 1: put the reflector at tool, lock the beam, record
14 STOP M0
15 CYCL DEF 9.0 DWELL TIME
16 CYCL DEF 9.1 DWELL 2.000
17 L X+100.000 Y+50.000 Z-100.000 R0 F15000 M91
18 CYCL DEF 9.0 DWELL TIME
19 CYCL DEF 9.1 DWELL 0.250
20 L X+100.000 Y+50.000 Z+12.500 R0 F3000 M91
21 CYCL DEF 9.0 DWELL TIME
22 CYCL DEF 9.1 DWELL 2.000
23 M30
24 END PGM OTFPATH_1 MM
""",
    'linuxcnc': """\
(HEAD -1-)
G21 G90 G94 G17 G40 G49 G80
(APPROACH: Z TO THE TOP OF THE PART, THEN TO ITS START)
G61.1 G53 G1 Z12.500 F3000
G61.1 G53 G1 X0.000 Y0.000 F3000
G61.1 G53 G1 Z-100.000 F3000
(part 1: put the reflector at tool, lock the beam, record)
M0
G4 P2.000
G61.1 G53 G1 X100.000 Y50.000 Z-100.000 F15000
G4 P0.250
G61.1 G53 G1 X100.000 Y50.000 Z12.500 F3000
G4 P2.000
G94
M2
""",
    'twincat': """\
% OTF_PATH_1
; HEAD -1-
; G53 MUST BE WITHOUT OFFSET: G53_VERFUEGBAR 0 - NO G92, NO CS ACTIVE
G71 G90 G94 G17 G40
G53
D0
; APPROACH: Z TO THE TOP OF THE PART, THEN TO ITS START
G60 G90 G01 Z12.500 F3000
G60 G90 G01 X0.000 Y0.000 F3000
G60 G90 G01 Z-100.000 F3000
; part 1: put the reflector at tool, lock the beam, record
M00
G04 X2.000
G60 G90 G01 X100.000 Y50.000 Z-100.000 F15000
G04 X0.250
G60 G90 G01 X100.000 Y50.000 Z12.500 F3000
G04 X2.000
G94 G90
M30
""",
}
every_dialect = pytest.mark.parametrize('name', EXPECTED)


def little(points=POINTS, feed=(0.25, 0.05), dwell=(2.0, 0.25, 2.0)):
    return Plan.along(points, np.array(feed), np.array(dwell))


@every_dialect
def test_program_word_by_word(name):
    assert program(DIALECTS[name], little(), ['HEAD (1)']) == EXPECTED[name]


@every_dialect
def test_positions_are_rounded_to_increments(name):
    machine = some_machine(ranges=3 * [(-1.0, 1.0)])
    fitted = on_increments(machine, little(POINTS + np.array([0, 4e-7, 0])))
    assert program(DIALECTS[name], fitted, ['HEAD (1)']) == EXPECTED[name]


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


@every_dialect
def test_a_long_comment_is_broken_between_words_and_keeps_them_all(name):
    text = program(DIALECTS[name], little(), ['TRY IT IN THE AIR FIRST ' * 9])
    kept = [line for line in text.splitlines() if 'TRY' in line or 'FIRST' in line]
    assert max(map(len, kept)) <= 80 and len(kept) > 2
    words = re.findall('TRY|IT|IN|THE|AIR|FIRST', ' '.join(kept))
    assert words == 9 * ['TRY', 'IT', 'IN', 'THE', 'AIR', 'FIRST']


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


@pytest.mark.parametrize(
    ('wrong', 'right'), [('G9', 'G61.1'), ('', 'M2'), ('G53 G1 X1 F0', 'G4 P2.000')]
)
def test_linuxcnc_interpreter_refuses_wrong_programs(rs274, wrong, right):
    text = program(DIALECTS['linuxcnc'], little(), [])
    assert rs274(text).code == 0
    assert rs274(text.replace(right, wrong)).code != 0

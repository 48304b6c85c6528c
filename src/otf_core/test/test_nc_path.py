# SPDX-License-Identifier: Apache-2.0
"""NC programs as paths: every program that is planned, programs of other people, refusals."""

import numpy as np
import pytest
from core_cells import program

from otf_core.errors import ConfigError
from otf_core.inputs.nc_program import is_program, read_program
from otf_core.model.plan import Plan
from otf_core.planning.nc import DIALECTS

every_dialect = pytest.mark.parametrize('name', DIALECTS)
NASTY = ['G1 X1 Y2 Z3; (MILL) #1 IF', 'BEGIN PGM', 'L X+1']


def driven(points):
    """Points without those that repeat the one before."""
    moves = np.concatenate([[True], np.any(np.diff(points, axis=0) != 0, axis=1)])
    return points[moves]


def random_plan(seed):
    rng = np.random.default_rng(seed)
    points = np.round(rng.uniform(-0.9, 0.9, (12, 3)), 6)
    points[5] = points[4]
    points[8, :2] = points[7, :2]
    return Plan.along(points, np.full(11, 0.1), np.round(rng.uniform(0.01, 3.0, 12), 3))


def read(tmp_path, text, name='PROGRAM.NC'):
    (tmp_path / name).write_text(text)
    return read_program(tmp_path / name)


@every_dialect
@pytest.mark.parametrize('seed', range(5))
def test_any_plan_comes_back_from_its_program(tmp_path, name, seed):
    plan = random_plan(seed)
    got = read(tmp_path, program(DIALECTS[name], plan, NASTY))
    assert got.points.tobytes() == (driven(plan.path.points) + 0.0).tobytes()


CORNERS = [[0.1, 0.0, -0.05], [0.2, 0.0, -0.05], [0.2, 0.15, -0.05], [0.2, 0.15, 0.0125]]
SAME = {
    'modal words, no spaces': 'G21G90G1X100Y0Z-50F500\nX200.\nY150.0\nZ12.5\nM30\n',
    'lower case, numbered, comments': (
        '%\n(part of it)\nO7 (x)\nn10 g21 g90 (mm) g17\nn20 g0 x100 y0 z-50 ; G1 X1\n'
        'n30 g1 x200. f900\nn40 y+150 s500 m3\nn50 z 12.5 m8\nm02\n'
    ),
    'increments': 'G21 G90 G0 X100 Y0 Z-50\nG91 G1 X100 F10\nY150\nZ62.5\nM30\nX1\n',
    'single increments of SINUMERIK': (
        'G710 G90\nMSG("G1 X0; (a)")\nFFWON SOFT\nN5 SUPA G0 X=100 Y0 Z=AC(-50)\nG1 X=IC(100) '
        'F=500\nY150 S1=500 M1=3\nG4 F1\nSUPA Z=IC(62.5)\nM17\n'
    ),
    'inches': (
        'G20 G90\nG1 X3.937007874015748 Y0 Z-1.968503937007874\nG21\nX200\nY150\nZ12.5\nM2\n'
    ),
    'dwells that look like moves': (
        'G21 G90\nG1 X100 Y0 Z-50\nG04 X2.5\nG4 P10\nX200\nY150\nG4 F1.\nZ12.5\nM30\n'
    ),
    'a retract in machine coordinates': (
        'G21 G90 G54\nT1 M6\nG0 G53 Z0\nG1 X100 Y0 Z-50\nX200\nY150\nZ12.5\nG28 G91 Z0\nG90\n'
        'G28 X0 Y0\nM30\n'
    ),
    'HEIDENHAIN ISO': (
        '%OTF G71 *\nN10 G00 G40 G90 X+100 Y+0 Z-50 *\nN20 G01 X+200 F500 *\nN30 Y+150 M3 *\n'
        'N40 Z+12.5 *\nN99999999 %OTF G71 *\n'
    ),
    'Klartext': (
        '0 BEGIN PGM OTF MM\n1 BLK FORM 0.1 Z X+0 Y+0 Z-20\n2 BLK FORM 0.2 X+9 Y+9 Z+0\n'
        '3 TOOL CALL 5 Z S500\n4 L X+100 Y+0 FMAX M3\n5 L Z-50 R0 FMAX\n6 L IX+100 F500\n'
        '7 ; L X+1\n8 L Y+150,000\n9 CYCL DEF 32.0 TOLERANCE\n10 CYCL DEF 32.1 T0.01\n'
        '11 L ~\nZ+12.5 FAUTO\n12 M5\n13 L M30\n14 END PGM OTF MM\n'
    ),
    'Klartext in inches, not numbered': (
        'BEGIN PGM A INCH\nL X+3.937007874015748 Y+0 Z-1.968503937007874 F100\n'
        'L X+7.874015748031496\nL Y+5.905511811023622\nL IZ+2.460629921259843\nEND PGM A INCH\n'
    ),
}  # fmt: skip


@pytest.mark.parametrize('text', SAME.values(), ids=SAME)
def test_programs_of_other_people(tmp_path, text):
    assert is_program_text(tmp_path, text)
    points = read(tmp_path, text).points
    points = points[1:] if 'BLK' in text and len(points) > 4 else points
    np.testing.assert_allclose(points, CORNERS, atol=1e-12)


def is_program_text(tmp_path, text):
    (tmp_path / 'looked.txt').write_text(text)
    return is_program(tmp_path / 'looked.txt')


START = 'G21 G90 G1 X0 Y0 Z0 F100\nX50\n'
REFUSED = {
    'G68 R30': "line 3: 'G68' rotates",
    'G81 X10 Y10 Z-3 R1': "line 3: 'G81' is a cycle",
    'G41 D1 X10': "line 3: 'G41' switches cutter compensation",
    'G43 H1 Z5': "line 3: 'G43' switches a tool length offset",
    'G92 X0': "line 3: 'G92' shifts",
    'G52 X10': "line 3: 'G52' shifts",
    'G51 X0 Y0 P2': "line 3: 'G51' scales",
    'G10 L2 P1 X5': "line 3: 'G10' sets offsets",
    'G5.1 X5': "line 3: 'G5.1' drives a spline",
    'G123 X5': "line 3: 'G123' is not known",
    'M98 P100': "line 3: 'M98' calls a subprogram",
    'M99': "line 3: 'M99' repeats",
    'L100': "line 3: 'L100' calls a subprogram",
    'X10 A30': "line 3: 'A30' moves an axis other than X, Y, Z",
    'X10 C=IC(5)': r"line 3: 'C=IC\(5\)' ",
    'X#1': "line 3: 'X#1' holds a variable",
    '#1=5': "line 3: '#1=5' holds a variable",
    'X[1+2]': r"line 3: 'X\[1\+2\]' holds a variable",
    'X=R1': "line 3: 'X=R1' holds a variable",
    'X10*2': r"line 3: 'X10\*2' ",
    'R1=5': "line 3: 'R1=5' ",
    'TRANS X10': "line 3: 'TRANS' shifts",
    'CYCLE81(10,0)': "line 3: 'CYCLE81",
    'TRAORI': "line 3: 'TRAORI' shifts",
    'POLYPATH X5': "line 3: 'POLYPATH' is not known",
    'IF R1==2 GOTOF A': "line 3: 'R1==2' holds a variable",
    'GOTOF A1': "line 3: 'GOTOF' is a cycle, a call",
    'G2 X10 Y10': 'line 3: .* is an arc without centre',
    'G2 X10 Y10 I1 J1': 'line 3: .* whose ends lie',
    'G2 X10 Y10 R5': 'line 3: .* farther apart than 2 R',
    'X10 X20': "line 3: 'X20' is a second X",
    'X1e5': "line 3: 'E5' is not supported",
    '/X10': 'line 3: .* is skipped or executed depending on a switch',
    'G91 G53 X10': 'line 3: .* with increments',
    'G28 X0\nX5': "line 3: 'G28 X0' goes to a position that is not in the program",
    '(open': 'line 3: .* is a comment that is not closed',
    'D1': "line 3: 'D1' applies a tool offset",
    f'X{"1" * 50}': 'line 3: .* too many digits',
}


@pytest.mark.parametrize(('word', 'said'), REFUSED.items())
def test_what_may_move_an_axis_otherwise_is_refused_with_line_and_word(tmp_path, word, said):
    with pytest.raises(ConfigError, match=said) as refused:
        read(tmp_path, f'{START}{word}\nX0\nM30\n')
    assert 'plan.json' in str(refused.value)


KLARTEXT_REFUSED = {
    'CYCL DEF 7.0 DATUM SHIFT': "line 3: 'CYCL DEF 7.0 DATUM SHIFT' shifts",
    'CYCL DEF 200 DRILLING': 'is a cycle',
    'CYCL CALL': 'is a cycle',
    'CALL LBL 1 REP 2': 'is a subprogram or a call',
    'LBL 1': 'is a subprogram or a call',
    'FN 0: Q1 = +5': 'holds a variable',
    'L X+Q1': r"'X\+Q1' is not supported",
    'L X+5 RL': "'RL' switches cutter compensation",
    'L B+10': r"'B\+10' moves an axis other",
    'L X+5 M128': "'M128' is not supported",
    'M128': "'M128' is not known",
    'RND R5': 'is a path function that is not read',
    'LP PR+5 PA+3': 'is a path function that is not read',
    'PLANE SPATIAL SPA+5': 'shifts or turns',
    'C X+5 Y+5 DR+': 'is a circle without a centre',
    'CC Z+5': 'is not a centre in the plane',
}


@pytest.mark.parametrize(('word', 'said'), KLARTEXT_REFUSED.items())
def test_klartext_that_may_move_an_axis_otherwise_is_refused(tmp_path, word, said):
    start = '0 BEGIN PGM A MM\n1 L X+0 Y+0 Z+0 FMAX\n'
    with pytest.raises(ConfigError, match=f'line 3: .*{said}|{said}'):
        read(tmp_path, f'{start}2 {word}\n3 L X+9 F100\n4 END PGM A MM\n')


# ---------------------------------------------------------------- arcs

QUARTER = {
    'centre': 'G3 X0 Y50 I-50 J0',
    'radius': 'G3 X0 Y50 R50',
    'radius of SINUMERIK': 'G3 X0 Y50 CR=50',
    'absolute centre of SINUMERIK': 'G3 X0 Y50 I=AC(0) J=AC(0)',
    'absolute centre of LinuxCNC': 'G90.1\nG3 X0 Y50 I0 J0',
    'increments': 'G91 G3 X-50 Y50 I-50',
}


@pytest.mark.parametrize('text', QUARTER.values(), ids=QUARTER)
def test_a_quarter_of_a_circle(tmp_path, text):
    got = read(tmp_path, f'G21 G90 G17\nG1 X50 Y0 Z0 F100\n{text}\nM30\n')
    check_arc(got.points, radius=0.05, turn=0.5 * np.pi)
    assert got.arcs == 1 and '1 arcs, as chords' in got.said


def check_arc(points, radius, turn, plane=(0, 1)):
    u, v = plane
    np.testing.assert_allclose(np.hypot(points[:, u], points[:, v]), radius, atol=1e-12)
    angle = np.unwrap(np.arctan2(points[:, v], points[:, u]))
    assert np.ptp(angle) == pytest.approx(abs(turn), abs=1e-9)
    assert np.all(np.sign(np.diff(angle)) == np.sign(turn))
    chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert chord.min() > 1e-4 and chord.max() <= 1e-3 + 1e-12
    assert abs(np.diff(angle)).max() <= np.radians(5.0) + 1e-12
    assert len(points) > 3


def test_full_circles_and_helices_in_every_plane(tmp_path):
    check_arc(read(tmp_path, 'G1 X50 Y0 Z0\nG2 I-50\nM30\n').points, 0.05, -2 * np.pi)
    zx = read(tmp_path, 'G18 G1 X0 Y0 Z50\nG3 X0 Z50 K-50 Y20\nM30\n').points
    check_arc(zx[:, [2, 0]], 0.05, 2 * np.pi)
    np.testing.assert_allclose(np.diff(zx[:, 1], n=2), 0.0, atol=1e-12)
    assert zx[-1].tolist() == [0.0, 0.02, 0.05]
    yz = read(tmp_path, 'G19 G1 X0 Y50 Z0\nG3 Y0 Z50 J-50\nM30\n').points
    check_arc(yz[:, [1, 2]], 0.05, 0.5 * np.pi)


def test_circles_of_klartext(tmp_path):
    head = 'BEGIN PGM A MM\nL X+50 Y+0 Z+0 F100\n'
    check_arc(read(tmp_path, f'{head}CC X+0 Y+0\nC X+0 Y+50 DR+ F100\nEND PGM A MM\n').points,
              0.05, 0.5 * np.pi)  # fmt: skip
    check_arc(read(tmp_path, f'{head}CC IX-50 IY+0\nC X+50 Y+0 DR-\nEND PGM A MM\n').points,
              0.05, -2 * np.pi)  # fmt: skip
    check_arc(read(tmp_path, f'{head}CR X+0 Y+50 R+50 DR+\nEND PGM A MM\n').points,
              0.05, 0.5 * np.pi)  # fmt: skip


# ---------------------------------------------------------------- approach, start, what it is


def test_only_a_short_way_before_the_first_stop_is_the_approach(tmp_path):
    rows = [f'G1 X{k} Y0 Z0 F100' for k in range(8)]
    text = '\n'.join([*rows, 'M0', 'G1 X50', 'M0', 'G1 X60', 'M30'])
    assert len(read(tmp_path, f'{text}\n').points) == 10
    late = '\n'.join([*rows[:3], 'M0', 'G1 X50', 'G1 X60', 'M30'])
    got = read(tmp_path, f'{late}\n')
    assert got.points[:, 0].tolist() == [0.002, 0.05, 0.06]
    assert '3 moves before the first program stop are treated as the approach' in got.said


def test_a_start_that_is_not_stated_is_refused(tmp_path):
    moves = '\n'.join(f'X{k} Y{k % 2}' for k in range(9))
    with pytest.raises(ConfigError, match='Z'):
        read(tmp_path, f'G1 F100\n{moves}\nZ5\nM30\n')
    with pytest.raises(ConfigError, match='Z'):
        read(tmp_path, 'G1 X0 Y0 F100\nX10\nM30\n')
    with pytest.raises(ConfigError, match='without any motion'):
        read(tmp_path, 'G1 X0 Y0 Z0 F100\nM30\n')


@pytest.mark.parametrize(
    'text',
    ['x,y,z\n0,0,0\n', 'X Y Z\n1 2 3\n', '1 0 0\n2 0 0\n', 'X,1.0,Y,2.0,Z,3.0\n', '{"a": 1}', '',
     'name: a\nchain: w-b-X-Y-Z-t\n', 'G;X;Y\n1;2;3\n', '# G1 X0\n0.1 0.2 0.3\n'],
)  # fmt: skip
def test_what_is_no_program(tmp_path, text):
    assert not is_program_text(tmp_path, text)

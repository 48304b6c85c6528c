# SPDX-License-Identifier: Apache-2.0
"""Paths driven otherwise than published, calibrated: as good as driven as planned.

Judged by an independent nature whose errors are polygons between the nodes, so that what is left
is noise and what the alignment did, not the shape of the errors.
"""

import numpy as np
import pytest
from nature import Cell, judge
from programs import arc, drive, programs, record, rounded

from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.inputs.nc_program import read_program
from otf_core.tracking.alignment import align

RATE = 50.0
FEED = 0.25
CELL = Cell(3, size=(0.3, 0.25, 0.2), pitch=0.05, form='polygon', path='short', passes=1)
P = CELL.path.points
PROGRAMS = programs(P)


@pytest.fixture(scope='module')
def once():
    """The run driven as planned: white and coloured noise, 50 Hz."""
    return calibrate_recordings([record(CELL, drive(P, FEED, rate=RATE), rate=RATE)])


@pytest.fixture(scope='module')
def as_planned(once):
    """Error left, um, of that run."""
    return judge(CELL, once.tables, once.covariance)


@pytest.mark.parametrize(
    'name',
    ['restarted from an earlier corner', 'a leg aborted, half driven back'],
)
def test_tables_are_as_good_as_those_of_the_run_driven_as_planned(name, as_planned):
    run = calibrate_recordings([record(CELL, drive(PROGRAMS[name], FEED, rate=RATE), rate=RATE)])
    found = judge(CELL, run.tables, run.covariance)
    assert as_planned.left_percent < 1.5
    # another draw of the noise: a quarter of 60 node values' scatter
    assert found.left_percent < 1.35 * as_planned.left_percent
    assert found.within_2u_percent > 75
    assert not run.failed_gates


def test_a_second_lap_is_worth_its_samples(once, as_planned):
    twice = calibrate_recordings(
        [record(CELL, drive(PROGRAMS['twice'], FEED, rate=RATE), rate=RATE)]
    )
    found = judge(CELL, twice.tables, twice.covariance)
    assert found.left_percent < as_planned.left_percent
    assert found.within_2u_percent > 75
    assert not twice.failed_gates
    assert twice.fit.used == pytest.approx(2 * once.fit.used, rel=0.01)
    assert twice.tables.squareness['C0Y'].u_run < 0.85 * once.tables.squareness['C0Y'].u_run


def test_smooth_corners_are_left_out_as_far_as_they_reach(as_planned):
    recording = record(CELL, drive(rounded(P, 0.03), FEED, rate=RATE), rate=RATE)
    config = CalibrationConfig(match_tolerance=0.004, corner_exclusion=0.03)
    run = calibrate_recordings([recording], config)
    found = judge(CELL, run.tables, run.covariance)
    assert found.left_percent < 1.35 * as_planned.left_percent
    assert not run.failed_gates


def test_corners_rounded_too_far_are_refused_with_what_to_set():
    recording = record(CELL, drive(rounded(P, 0.03), FEED, rate=RATE), rate=RATE)
    with pytest.raises(InputError, match=r'its corners are rounded: raise match_tolerance to'):
        align(recording.samples, recording.path, CalibrationConfig())


# ---------------------------------------------------------------- curves

CENTRE = 0.5 * (CELL.machine.lower + CELL.machine.upper)
PLANES = ((0, 1, 2), (0, 2, 1), (1, 2, 0))
CURVE_RATE = 200.0


def circles(chord, radius=0.09):
    """Two full circles in planes of every orientation."""
    unit = np.eye(3)
    return np.concatenate(
        [
            arc(CENTRE + level * unit[c], unit[a], unit[b], radius, 0.3, 0.3 + 2 * np.pi, chord)
            for a, b, c in PLANES
            for level in (-0.06, 0.06)
        ]
    )


def left(driven, published):
    recording = record(CELL, drive(driven, 0.15, rate=CURVE_RATE), published, rate=CURVE_RATE)
    run = calibrate_recordings([recording])
    assert not run.failed_gates
    return run, judge(CELL, run.tables, run.covariance)


@pytest.fixture(scope='module')
def lines_only():
    return left(P, P)[1]


def test_circles_of_chords_beside_lines_leave_no_more_than_lines(lines_only):
    path = np.concatenate([P, circles(1e-3)])
    run, found = left(path, path)
    assert found.left_percent < 1.2 * lines_only.left_percent
    assert found.within_2u_percent > 80
    assert not run.warnings[1:]  # the first says what u contains


def test_circles_alone_give_tables_where_they_were_driven():
    path = circles(1e-3)
    cell = Cell(3, size=(0.3, 0.25, 0.2), pitch=0.05, form='polygon', path=path, passes=1)
    recording = record(cell, drive(path, 0.15, rate=CURVE_RATE), path, rate=CURVE_RATE)
    run = calibrate_recordings([recording])
    found = judge(cell, run.tables, run.covariance)
    assert found.left_percent < 10
    assert found.within_2u_percent > 75


def program_of(lines, radius=0.09, begin=0.3):
    """G-code of lines and of the arcs that ``circles`` has as chords."""
    rows = ['G21 G90 G1 F9000', *('X{:.9f} Y{:.9f} Z{:.9f}'.format(*(1e3 * p)) for p in lines)]
    unit = np.eye(3)
    for a, b, c in PLANES:
        word, sense = {(0, 1): ('G17', 3), (0, 2): ('G18', 2), (1, 2): ('G19', 3)}[a, b]
        for level in (-0.06, 0.06):
            from_centre = radius * (np.cos(begin) * unit[a] + np.sin(begin) * unit[b])
            start = 1e3 * (CENTRE + level * unit[c] + from_centre)
            rows.append('{} G1 X{:.9f} Y{:.9f} Z{:.9f}'.format(word, *start))
            back = -1e3 * from_centre
            rows.append(f'G{sense} {"IJK"[a]}{back[a]:.9f} {"IJK"[b]}{back[b]:.9f}')
    return '\n'.join([*rows, 'M30', ''])


def test_an_nc_program_with_arcs_is_the_path_that_was_driven(tmp_path, lines_only):
    (tmp_path / 'run.nc').write_text(program_of(P))
    program = read_program(tmp_path / 'run.nc')
    assert program.arcs == 6 and len(program.points) > 3000
    run, found = left(np.concatenate([P, circles(1e-4)]), program.points)
    assert found.left_percent < 1.2 * lines_only.left_percent
    assert not run.warnings[1:]  # the first says what u contains

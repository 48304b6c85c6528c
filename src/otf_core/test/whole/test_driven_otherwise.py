# SPDX-License-Identifier: Apache-2.0
"""Paths that are driven otherwise than published: which sample lies on which leg."""

import numpy as np
import pytest
from nature import Cell
from programs import drive, held, programs, record, rounded

from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.tracking.alignment import align
from otf_core.tracking.curves import Lines
from otf_core.tracking.driving_order import OFF_PATH
from otf_core.tracking.path_watch import PathWatcher

CONFIG = CalibrationConfig()
RATE = 50.0
FEED = 0.25
CELL = Cell(3, size=(0.3, 0.25, 0.2), pitch=0.05, form='polygon', path='short', passes=1)
P = CELL.path.points
PROGRAMS = programs(P)


def check(recording, q, rate=RATE):
    """Align; every sample of a leg was programmed on it and moves along it. The alignment."""
    found = align(recording.samples, recording.path, CONFIG)
    lines = Lines.of(found.shape)
    off = found.T_machine_tracker.apply(recording.samples.xyz) - CELL.position(q)
    assert np.linalg.norm(off, axis=1).max() < 2e-4  # errors of the machine are 60 um
    speed = np.gradient(q, axis=0) * rate
    moving = np.linalg.norm(speed, axis=1) > 1e-4
    on = (found.leg != OFF_PATH) & moving
    leg = found.leg[on]
    along = lines.along(q[on], leg)
    beside = q[on] - found.corners[leg] - along[:, None] * lines.unit[leg]
    place = lines.start[leg] + along
    # a hop at a corner belongs to either leg; 5 mm between samples
    inner = (place > 0.006) & (place < lines.total[leg] - 0.006)
    assert np.linalg.norm(beside[inner], axis=1).max() < 1e-6
    assert np.einsum('ij,ij->i', speed[on], lines.unit[leg])[inner].min() > 0
    assert np.all(np.diff(found.leg[on]) >= -1)  # the driven path is in order of time
    return found, on.sum() / moving.sum()


@pytest.mark.parametrize('name', PROGRAMS)
def test_every_sample_lies_on_its_leg_and_moves_along_it(name):
    q = drive(PROGRAMS[name], FEED, rate=RATE)
    found, share = check(record(CELL, q, rate=RATE), q)
    # what is off the path is left out: connecting moves, at most an aborted leg and a short cut
    assert share > (0.9 if 'corner' in name or 'retract' in name else 0.97)
    skipped = 'skipped' in name or 'left out' in name
    assert found.coverage == pytest.approx(0.93 if skipped else 1.0, abs=0.06)


def test_feed_holds_in_mid_leg_of_a_second_lap_change_nothing():
    q = held(drive(PROGRAMS['twice'], FEED, rate=RATE), RATE, 0.21, 0.58, 0.77)
    found, share = check(record(CELL, q, rate=RATE), q)
    assert share > 0.97
    assert found.coverage > 0.97


def test_legs_of_the_driven_path_name_those_published():
    q = drive(PROGRAMS['restarted from an earlier corner'], FEED, rate=RATE)
    found, _ = check(record(CELL, q, rate=RATE), q)
    corners, _ = CELL.path.corners()
    driven = found.published != OFF_PATH
    number = found.published[driven]
    for j, published in zip(np.flatnonzero(driven), number, strict=True):
        np.testing.assert_array_equal(found.corners[j : j + 2], corners[published : published + 2])
    step = np.diff(number)
    assert np.count_nonzero(step < 0) == 1
    assert number[-1] == len(corners) - 2


def test_a_path_driven_as_planned_keeps_its_corners():
    q = drive(P, FEED, rate=RATE)
    found, _ = check(record(CELL, q, rate=RATE), q)
    np.testing.assert_array_equal(found.corners, CELL.path.corners()[0])
    np.testing.assert_array_equal(found.published, np.arange(len(found.corners) - 1))


# ---------------------------------------------------------------- refused with a reason


def refusal(samples, path):
    with pytest.raises(InputError) as caught:
        align(samples, path, CONFIG)
    return str(caught.value)


@pytest.mark.parametrize('name', ['forth and back'])
def test_a_mirrored_tracker_is_named_however_the_path_is_driven(name):
    samples = record(CELL, drive(PROGRAMS[name], FEED, rate=RATE), rate=RATE).samples
    flipped = Samples(samples.stamp_ns, samples.xyz * [1.0, -1.0, 1.0])
    assert 'mirrored' in refusal(flipped, CELL.path)


def test_another_path_is_refused_though_legs_may_be_driven_in_any_order():
    samples = record(CELL, drive(PROGRAMS['twice'], FEED, rate=RATE), rate=RATE).samples
    other = NominalPath(np.random.default_rng(1).permutation(P))
    assert 'do bag and path belong together' in refusal(samples, other)


def test_corners_rounded_over_whole_legs_are_refused():
    samples = record(CELL, drive(rounded(P, 1.0), FEED, rate=RATE), rate=RATE).samples
    assert 'samples do not follow the path' in refusal(samples, CELL.path)


# ---------------------------------------------------------------- live


def at_end(points):
    samples = record(CELL, drive(points, FEED, rate=RATE), rate=RATE).samples
    return PathWatcher(CELL.path, CONFIG).look(samples).to_the_end


@pytest.mark.parametrize(
    ('points', 'expected'),
    [
        (P, True),
        (PROGRAMS['twice'], True),
        (np.concatenate([P, P[1:20]]), False),
        (PROGRAMS['forth and back'], False),
        (PROGRAMS['the last third backward once more'], False),
        (P[:30], False),
    ],
    ids=['once', 'twice', 'in the second lap', 'back at the start', 'on the way back', 'early'],
)
def test_the_end_of_the_path_is_where_its_last_leg_ended_last(points, expected):
    assert at_end(points) is expected

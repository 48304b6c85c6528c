# SPDX-License-Identifier: Apache-2.0
"""When legs began, from samples of a drive whose starts are known."""

import numpy as np

from otf_core.model.frames import RigidTransform
from otf_core.model.observation import Samples
from otf_core.tracking.curves import Lines, straight_shape
from otf_core.tracking.leg_starts import leg_starts
from otf_core.tracking.matching import OFF_PATH

CORNERS = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.2, 0.0], [0.0, 0.2, 0.1]])
BEGAN = (1.0037, 4.2081, 7.9446)
FEED = (0.1, 0.2, 0.15)


def driven(jerk_time=0.0):
    """Samples at 100 Hz: acceleration that the jerk smears, a stop at every corner."""
    time = np.arange(0.0, 12.0, 1e-4)
    speed, leg = np.zeros_like(time), np.zeros(len(time), dtype=np.int32)
    for number, (began, feed) in enumerate(zip(BEGAN, FEED, strict=True)):
        length = np.linalg.norm(np.diff(CORNERS, axis=0)[number])
        ramp = feed / 2.0
        end = began + length / feed + ramp
        since, left = time - began, end - time
        speed += np.clip(2.0 * np.minimum(since, left), 0.0, feed)
        leg[time > began - 0.2] = number
    if jerk_time:
        width = int(jerk_time / 1e-4)
        speed = np.convolve(speed, np.ones(width) / width)[: len(speed)]
    way = np.concatenate([[0.0], np.cumsum(0.5e-4 * (speed[1:] + speed[:-1]))])
    ends = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(CORNERS, axis=0), axis=1))])
    points = np.stack([np.interp(way, ends, CORNERS[:, k]) for k in range(3)], axis=1)
    rng = np.random.default_rng(5)
    return (
        time[::100],
        points[::100] + 1e-6 * rng.standard_normal((len(time[::100]), 3)),
        leg[::100],
    )


def starts(time, points, leg):
    """Starts as seen by a tracker that is turned and far away."""
    turn, place = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), [2.0, 1.0, 0.0]
    pose = RigidTransform(turn, np.array(place))
    samples = Samples(np.rint(1e9 * time).astype(np.int64), (points - place) @ turn)
    return leg_starts(samples, pose, leg, Lines.of(straight_shape(CORNERS)))


def test_legs_begin_when_the_drive_leaves_the_corner():
    found = starts(*driven())
    assert np.allclose(found, BEGAN, atol=2e-3)


def test_limited_jerk_shifts_all_legs_alike():
    late = starts(*driven(0.05)) - BEGAN
    assert np.all((late > 0.0) & (late < 0.05)) and np.ptp(late) < 4e-3


def test_a_leg_without_a_stop_before_it_is_not_told():
    time, points, leg = driven()
    moving = leg.copy()
    moving[time < 3.0] = OFF_PATH
    found = starts(time, points + np.outer(time, [1e-2, 1e-2, 1e-2]), moving)
    assert np.isnan(found).all()

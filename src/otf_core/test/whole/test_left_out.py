# SPDX-License-Identifier: Apache-2.0
"""What was left out as outliers: dents and bursts that are put into samples of a small cell."""

import numpy as np
import pytest
from core_cells import record, small_plan, some_machine, some_pose

from otf_core.calibration.calibrate import solve_recordings
from otf_core.config import CalibrationConfig
from otf_core.model.observation import Samples
from otf_core.pieces.runs import Recording

DENT = 0.12


def chip_under_the_slide(driven, rng):
    """80 um over 20 mm of X, whenever it comes by."""
    bump = np.exp(-0.5 * ((driven.q[:, 0] - DENT) / 0.006) ** 2)
    return 8e-5 * bump[:, None] * [0.0, 0.7, 1.0]


def rounded_corners(driven, rng):
    """Up to 0.15 mm towards the middle of the volume over 30 mm from every corner."""
    near = np.min([np.linalg.norm(driven.q - p, axis=1) for p in driven.path.points], axis=0)
    middle = 0.5 * (driven.machine.lower + driven.machine.upper)
    return 1.5e-4 * np.clip(1.0 - near / 0.03, 0.0, None)[:, None] * np.sign(middle - driven.q)


def bursts(driven, rng):
    """0.1 mm for a fifth of a second, twelve times."""
    moved = np.zeros_like(driven.q)
    for at in rng.uniform(0.05, 0.95, 12) * driven.time[-1]:
        moved[np.abs(driven.time - at) < 0.1] = 1e-4 * rng.choice([-1.0, 1.0], 3)
    return moved


def stray(driven, rng):
    """0.3 mm on single samples here and there, 8 % of all."""
    bad = rng.random(len(driven.q)) < 0.08
    return 3e-4 * bad[:, None] * rng.standard_normal((len(driven.q), 3))


def waves(driven, rng):
    """A wave of 60 um, 13 mm long along X, across it."""
    return 6e-5 * np.sin(2 * np.pi * driven.q[:, :1] / 0.013) * [0.0, 0.7, 1.0]


def recording(spoil, rate=40.0):
    """Two passes with something added; one with waves, which lie at the same places each time."""
    machine = some_machine(pitch=0.1)
    passes = 1 if spoil is waves else 2
    driven = record(machine, small_plan(machine, passes=passes), rate=rate)
    rng = np.random.default_rng([71, 3])
    pose = some_pose(machine, rng)
    samples = driven.measured(seed=5, pose=pose)
    xyz = samples.xyz + spoil(driven, rng) @ pose[0].T
    return Recording(Samples(samples.stamp_ns, xyz), driven.path, machine)


@pytest.mark.parametrize(
    ('spoil', 'again', 'at_corners', 'too_many'),
    [
        (chip_under_the_slide, True, False, False),
        (rounded_corners, True, True, True),
        (bursts, False, False, False),
        (waves, False, False, True),
    ],
)
def test_what_the_machine_does_is_told_from_bad_samples(spoil, again, at_corners, too_many):
    run, coarse = recording(spoil), {'reversal': 'none', 'piece_length': 0.024}
    solved = solve_recordings([run], CalibrationConfig(**coarse))
    (left,) = solved.outliers
    assert (left.again, left.at_corners, left.too_many) == (again, at_corners, too_many)
    said = [f.words for f in solved.findings if f.check == 'left out']
    assert len(said) == 1 and f'{left.samples} samples left out' in said[0]
    assert ('includes them in the gap' in said[0]) == again
    assert ('all but the most distant in the gap' in said[0]) == (too_many and not again)
    if spoil is chip_under_the_slide:
        assert np.allclose([p[0] for p in left.places], DENT, atol=0.04)
        assert 'all near X 0.1' in said[0] and 'same places in every pass' in said[0]


def test_stray_samples_that_meet_by_chance_are_not_what_the_machine_does():
    run, coarse = recording(stray, rate=200.0), {'reversal': 'none', 'piece_length': 0.024}
    (left,) = solve_recordings([run], CalibrationConfig(**coarse)).outliers
    assert left.samples > 0.05 * left.of
    assert left.repeated < 0.3 and not left.by_machine
    assert 'probably real machine behaviour' not in left.words()

# SPDX-License-Identifier: Apache-2.0
"""What was left out as outliers: single samples, and whole pieces of the path."""

import numpy as np
import pytest
from core_cells import record, small_plan, some_machine, some_pose

from otf_core.calibration.calibrate import solve_recordings
from otf_core.config import CalibrationConfig
from otf_core.contradictions.examine import WARNING_LEFT_OUT, share_in_whole_pieces
from otf_core.model.observation import Samples
from otf_core.pieces.runs import Recording

CONFIG = CalibrationConfig(reversal='none', piece_length=0.024)


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


@pytest.mark.parametrize('spoil', [rounded_corners, bursts, waves])
def test_whole_pieces_that_were_left_out_are_told_from_stray_samples(spoil):
    solved = solve_recordings([recording(spoil)], CONFIG)
    (said,) = [f.words for f in solved.findings if f.check == 'left out']
    left_out = solved.solution.runs[0].pieces.outliers
    assert said.startswith(f'{left_out} samples left out as outliers (')
    assert 'in whole pieces of the path' in said


def test_stray_samples_are_counted_and_stay_out_of_the_gap():
    solved = solve_recordings([recording(stray, rate=200.0)], CONFIG)
    (said,) = [f.words for f in solved.findings if f.check == 'left out']
    assert said.endswith('samples left out as outliers (8 %)')
    assert share_in_whole_pieces(solved.runs[0], solved.solution.runs[0]) < WARNING_LEFT_OUT

# SPDX-License-Identifier: Apache-2.0
"""What tables leave in every pass: told from noise, drift and vibration, and said."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import record, small_plan, some_machine, some_pose

from otf_core.calibration.calibrate import calibrate_recordings, solve_recordings
from otf_core.calibration.lack_of_fit import MIN_REPEATED_LINES, LackOfFit, find_lack_of_fit
from otf_core.config import CalibrationConfig
from otf_core.model.observation import Samples
from otf_core.pieces.runs import Recording

COARSE = CalibrationConfig(reversal='none', piece_length=0.024)


def nothing(driven):
    return np.zeros_like(driven.q)


def sag(driven):
    """Up to 8 um down where X and Y both are far from where they rest: no axis alone does it."""
    low, high = driven.machine.lower, driven.machine.upper
    x, y, _ = ((driven.q - low) / (high - low)).T
    return -8e-6 * np.stack([0 * x, 0 * x, np.sin(np.pi * x) * np.sin(np.pi * y)], axis=1)


def risen(driven):
    return -sag(driven)


def drift(driven):
    """The same to begin with, and less and less of it: no pass is as the other."""
    return sag(driven) * np.cos(np.pi * driven.time / driven.time[-1])[:, None]


def recording(spoil, passes=2, seed=8):
    machine = some_machine(pitch=0.1)
    driven = record(machine, small_plan(machine, passes=passes), rate=60.0)
    pose = some_pose(machine, np.random.default_rng(17))
    samples = driven.measured(seed=seed, pose=pose)
    xyz = samples.xyz + spoil(driven) @ pose[0].T
    return Recording(Samples(samples.stamp_ns, xyz), driven.path, machine)


def found(spoil, passes=2):
    solution = solve_recordings([recording(spoil, passes)], COARSE, repair=False).solution
    return find_lack_of_fit(solution.runs, solution.joint)


def test_what_repeats_is_measured_and_what_does_not_is_not():
    clean, changing, sagging = found(nothing), found(drift), found(sag)
    assert clean.lines == changing.lines == sagging.lines >= MIN_REPEATED_LINES
    assert abs(clean.square) < 3.0 * clean.u
    assert changing.square < 3.0 * changing.u
    assert sagging.square > 5.0 * sagging.u
    assert 0.5e-6 < sagging.size < 4e-6


def test_a_calibration_says_what_it_leaves_in_every_pass():
    said = [
        [
            w
            for w in calibrate_recordings([recording(s)], COARSE).warnings
            if 'in every pass over' in w
        ]
        for s in (nothing, sag)
    ]
    assert [len(one) for one in said] == [0, 1]
    assert 'which u does not include' in said[1][0]


def test_one_pass_tells_nothing():
    alone = found(sag, passes=1)
    assert alone is None or alone.warning(1e-9) is None


@pytest.mark.parametrize(
    ('change', 'told'),
    [
        ({}, True),
        ({'lines': MIN_REPEATED_LINES - 1}, False),
        ({'u': 0.5e-12}, False),
        ({'square': -1e-12}, False),
        ({'square': 0.01e-12, 'u': 0.0}, False),
    ],
)
def test_only_what_is_sure_and_matters_is_told(change, told):
    one = replace(LackOfFit(square=1e-12, u=0.1e-12, lines=60), **change)
    words = one.warning(0.5e-6)
    assert (words is not None) == told
    sizes = 'residual of 1 um, compared with a mean uncertainty of the grid of 0.5 um'
    assert not told or sizes in words


@pytest.mark.parametrize(
    ('between', 'machine'), [(None, True), (0.9e-12, True), (0.1e-12, False), (-1e-12, False)]
)
def test_what_comes_again_within_runs_alone_is_not_laid_on_the_axes(between, machine):
    words = LackOfFit(1e-12, 0.1e-12, 60, between).warning(0.5e-6)
    assert ('waves of a screw' in words) == machine
    assert 'the tracker has an error when pointing there' in words
    assert ('changed between the runs' in words) != machine
    assert ('pass of a run' in words) == (between is not None)


def test_between_runs_only_what_is_in_all_of_them_comes_again():
    def of(*spoils):
        given = [recording(s, passes=1, seed=k) for k, s in enumerate(spoils)]
        solution = solve_recordings(given, COARSE, repair=False).solution
        return find_lack_of_fit(solution.runs, solution.joint)

    same, turned = of(sag, sag), of(sag, risen)
    assert same.square > 5.0 * same.u
    assert turned.square < -5.0 * turned.u

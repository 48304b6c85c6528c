# SPDX-License-Identifier: Apache-2.0
"""Noise of standstills that a vibration shakes, and waves between nodes that it hides."""

from dataclasses import replace

import numpy as np
from engine_cells import cause_of, solved_rows

from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.diagnosed_rows import (
    remeasure_noise,
    remove_steady_vibration,
    straight_rows,
)
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.model.observation import Samples
from otf_core.noise.standstill import noise_model

CONFIG = CalibrationConfig()
FREQUENCY, RATE = 6.0, 100.0


def resting(rng):
    """Samples of a target that stands for 0.8 s at forty places, the noise as specified."""
    machine = solved_rows().runs[0].machine
    places = np.array([0.9, 0.2, 0.1]) + rng.uniform(-0.2, 0.2, (40, 3))
    xyz = np.repeat(places, 80, axis=0)
    reach = np.linalg.norm(xyz, axis=1)[:, None]
    noise = machine.tracker.u_angle * reach * rng.standard_normal(xyz.shape)
    along = xyz / reach
    noise += along * (
        machine.tracker.u_range * rng.standard_normal((len(xyz), 1))
        - np.sum(along * noise, axis=1)[:, None]
    )
    stamp = np.int64(1_700_000_000_000_000_000) + np.arange(len(xyz)) * np.int64(10_000_000)
    return Samples(stamp, xyz + noise)


def test_noise_is_that_of_the_samples_before_they_swung():
    run, pose = solved_rows().runs[0], solved_rows().done.runs[0].pose
    still = resting(np.random.default_rng(11))
    time = (still.stamp_ns - still.stamp_ns[0]) * 1e-9
    moved = np.outer(np.sin(2 * np.pi * FREQUENCY * time), [4e-6, -3e-6, 6e-6])
    shaken = replace(still, xyz=still.xyz + moved @ pose.rotation)
    size = {'frequency': FREQUENCY, 'S_X': 4e-6, 'S_Y': -3e-6, 'S_Z': 6e-6}
    found = AppliedEffect(REGISTRY['vibration'], size)
    calm = remeasure_noise(replace(run, samples=shaken), [found], pose.rotation, CONFIG)
    wanted, loud = (
        noise_model(samples, run.machine.tracker, CONFIG.standstill_speed)
        for samples in (still, shaken)
    )
    assert np.allclose(calm.noise.level, wanted.level) and max(loud.level / wanted.level) > 2.0
    assert np.allclose(calm.samples.xyz, still.xyz, atol=1e-12)


def test_noise_stays_where_nothing_steady_swings():
    rows = solved_rows()
    assert remove_steady_vibration(rows, [], CONFIG) is None
    assert (
        remove_steady_vibration(rows, [cause_of(REGISTRY['backlash'], held=1.0)], CONFIG) is None
    )


def test_straight_tables_are_left_as_they_are():
    rows = solved_rows()
    waves = cause_of(REGISTRY['table_resolution'], order=1.0)
    other = cause_of(REGISTRY['backlash'], held=1.0)
    assert straight_rows(rows, [other, waves], rows.done, {}, CONFIG, ()) is None

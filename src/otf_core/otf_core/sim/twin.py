# SPDX-License-Identifier: Apache-2.0
"""The twin of a real run: the same path, timing, tracker place, tables and noise.

What the same pipeline leaves on it is what the real run would leave if nothing were unmodelled.
The noise is that of the run's own standstills, each component with its level, colour and tails,
but no louder than specified: what is beyond is part of the gap, and its cause tracker_noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from otf_core.model.chain import exact_position
from otf_core.model.frames import RigidTransform
from otf_core.model.observation import Samples
from otf_core.model.path import Legs
from otf_core.model.tables import ErrorTables
from otf_core.noise.departure import simulated_noise
from otf_core.pieces.runs import Recording, Run
from otf_core.sim.tracker import measure
from otf_core.tracking.matching import OFF_PATH


def twin_recording(run: Run, pose: RigidTransform, tables: ErrorTables, seed: int) -> Recording:
    """Simulate a run again.

    Parameters
    ----------
    run : Run
        The real one: its samples give the timing along the path.
    pose : RigidTransform
        Tracker to machine.
    tables : ErrorTables
        As fitted to the real run.

    Returns
    -------
    Recording
        Samples off the path are left out.
    """
    samples, legs = run.samples, Legs(run.alignment.corners)
    on = run.alignment.leg != OFF_PATH
    leg = run.alignment.leg[on]
    along = np.clip(legs.along(pose.apply(samples.xyz[on]), leg), 0.0, legs.length[leg])
    q = legs.at(along, leg)
    true_points = (exact_position(tables, q) - pose.translation) @ pose.rotation
    noise = simulated_noise(run.noise, run.machine.tracker)
    rate = float(np.clip(1.0 / max(samples.step, 1e-9), 1.0, 5000.0))
    xyz = measure(true_points, noise, rate, np.random.default_rng([seed, 7]))
    return replace(run.recording, samples=Samples(samples.stamp_ns[on], xyz))

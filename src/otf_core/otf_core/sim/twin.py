# SPDX-License-Identifier: Apache-2.0
"""The twin of a real run: the same path, timing, tracker place and tables, noise as specified.

What the same pipeline leaves on it is what the real run would leave if nothing were unmodelled.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from otf_core.config import SimulationConfig
from otf_core.model.frames import RigidTransform
from otf_core.model.kinematics import exact_position
from otf_core.model.observation import Samples
from otf_core.model.path import Legs
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Recording, Run
from otf_core.sim.tracker import measure
from otf_core.tracking.matching import OFF_PATH

Array = NDArray[np.float64]


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
    seed : int

    Returns
    -------
    Recording
        Samples off the path are left out.
    """
    samples, legs = run.samples, Legs(run.shape.corners)
    on = run.alignment.leg != OFF_PATH
    leg = run.alignment.leg[on]
    along = np.clip(legs.along(pose.apply(samples.xyz[on]), leg), 0.0, legs.length[leg])
    q = legs.at(along, leg)
    true_points = (exact_position(tables, q) - pose.translation) @ pose.rotation
    seconds = max(samples.step, 1e-9)
    config = SimulationConfig(
        seed=seed,
        rate=float(np.clip(1.0 / seconds, 1.0, 5000.0)),
        correlated_share=1.0 - run.noise.white_angle,
        correlation_time=max(run.noise.correlation_time, 1e-3),
    )
    xyz = measure(true_points, run.machine, config, np.random.default_rng([seed, 7]))
    return replace(run.recording, samples=Samples(samples.stamp_ns[on], xyz))

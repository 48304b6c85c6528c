# SPDX-License-Identifier: Apache-2.0
"""Tables with a node at each end of an axis alone: straightness is zero, the rest is straight."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import error_of, record, small_plan, some_machine, some_pose

from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import CalibrationConfig
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.pieces.runs import Recording
from otf_core.sim.cell import random_tables


@pytest.mark.parametrize(('axes', 'reversal'), [('X', 'tables'), ('XYZ', 'auto')])
def test_pitch_may_be_the_whole_range(axes, reversal):
    machine = some_machine(pitch=0.1)
    coarse = {a: replace(axis, table_pitch=axis.max - axis.min) if a in axes else axis
              for a, axis in machine.axes.items()}  # fmt: skip
    machine = replace(machine, axes=coarse)
    truth = random_tables(machine, 2e-5, np.random.default_rng(6))
    driven = record(machine, small_plan(machine, passes=2), rate=60.0)
    pose = some_pose(machine, np.random.default_rng(7))
    run = Recording(driven.measured(truth, seed=4, pose=pose), driven.path, machine)
    found = calibrate_recordings([run], CalibrationConfig(piece_length=0.024, reversal=reversal))
    assert found.fit.path_mae_after < 0.1 * found.fit.path_mae_before
    points = lattice(machine)
    true = error_of(truth, points)
    left, before = (
        mean_length(without_rigid_motion(error, points))
        for error in (error_of(found.tables, points) - true, true)
    )
    assert left < 0.05 * before

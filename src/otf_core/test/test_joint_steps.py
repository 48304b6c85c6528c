# SPDX-License-Identifier: Apache-2.0
"""Steps of the joint solution that go too far; poses of its runs."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import record, small_plan, some_machine

from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import CalibrationConfig
from otf_core.errors import ConfigError
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.sim.cell import random_tables
from otf_core.solving import joint
from otf_core.solving.unknowns import layout, linear_bases


@pytest.mark.parametrize('factor', [2.5, 4.0])
def test_steps_that_grow_make_the_normal_matrix_anew(monkeypatch, factor):
    """As where the matrix of the first iteration is too small for what the data hardly show."""
    machine, config = some_machine(pitch=0.1), CalibrationConfig(piece_length=0.024)
    plan = small_plan(machine)
    truth = random_tables(machine, 2e-5, np.random.default_rng(3))
    driven = record(machine, plan, rate=50.0)
    recording = Recording(driven.measured(truth, seed=0), plan.path, machine)
    runs, nodes = prepare_runs([recording], config)
    unknowns = layout(linear_bases(machine, nodes))

    def solved():
        return joint.solve_jointly(runs, unknowns, config, lambda stage, fraction: None)

    right, improved, matrices = solved(), joint.newton_step, []

    def too_far(solution, *rest):
        better = improved(solution, *rest)
        matrices.append(solution.covariance)
        size = factor if solution.covariance is matrices[0] else 1.0
        return replace(solution, value=solution.value + size * (better.value - solution.value))

    monkeypatch.setattr(joint, 'newton_step', too_far)
    (found,), (wanted,) = solved().runs, right.runs
    assert np.abs(found.residual - wanted.residual).max() < 2e-8


def test_runs_from_one_station_share_a_pose_where_positions_are_counted_alike():
    machine = some_machine(pitch=0.1)
    longer = replace(machine, target_offset=machine.target_offset - [0.0, 0.0, 0.1])
    plan = small_plan(machine)
    driven = record(machine, plan, rate=50.0)
    recordings = [
        Recording(driven.measured(seed=k), plan.path, own)
        for k, own in enumerate((machine, machine, longer))
    ]
    runs, _ = prepare_runs(recordings, CalibrationConfig(), same_station=True)
    assert joint.station_numbers(runs) == [0, 0, 1]
    assert runs[1].pose is runs[0].pose


def test_a_method_that_does_not_exist_is_refused():
    with pytest.raises(ConfigError, match="method: 'stops' is unknown; possible: otf"):
        calibrate_recordings([], method='stops')

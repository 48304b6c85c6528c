# SPDX-License-Identifier: Apache-2.0
"""Runs from one place of the tracker; methods that do not exist."""

from dataclasses import replace

import pytest
from core_cells import record, small_plan, some_machine

from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import CalibrationConfig
from otf_core.errors import ConfigError
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.solving import joint


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

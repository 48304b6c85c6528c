# SPDX-License-Identifier: Apache-2.0
"""The process that calibrates for the node: errors, a calibration given up, an early end."""

import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
import yaml
from cells import MACHINE

from otf_calibrator.worker import Child, ChildError, internal_error
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import CalibrationConfig, PlannerConfig, SimulationConfig
from otf_core.errors import Cancelled, InputError, OtfError
from otf_core.model.machine import load_machine
from otf_core.model.observation import Samples
from otf_core.pieces.runs import Recording
from otf_core.planning.path_creation import plan_path
from otf_core.sim.cell import simulate

CONFIG = CalibrationConfig()


def ignored(stage, fraction):
    """Progress that nobody looks at."""


def solve(child, recording, progress=ignored, method='otf'):
    """Have a recording calibrated."""
    return child.do('calibrate', (recording, CONFIG, method, 'none'), progress)


@pytest.fixture(scope='module')
def recording(tmp_path_factory):
    file = tmp_path_factory.mktemp('machine') / 'machine.yaml'
    file.write_text(yaml.safe_dump(MACHINE))
    machine = load_machine(file)
    plan = plan_path(machine, PlannerConfig(passes=1, levels=2))
    samples = simulate(machine, plan, SimulationConfig(rate=50.0)).samples
    return Recording(samples, plan.path, machine, 'samples')


@pytest.fixture
def solver():
    solver = Child()
    yield solver
    solver.close()


def test_tables_are_those_of_this_process_bit_by_bit(solver, recording):
    found = solve(solver, recording)
    plain = calibrate_recordings([recording], CONFIG)
    assert found.run_id == plain.run_id
    for name, table in plain.tables.motions.items():
        assert found.tables.motions[name].value.tobytes() == table.value.tobytes()
        assert found.tables.motions[name].u.tobytes() == table.u.tobytes()


def test_what_is_wrong_with_a_run_is_said_and_the_process_goes_on(solver, recording):
    still = Samples(np.arange(500) * 2_000_000, np.ones((500, 3)))
    with pytest.raises(InputError, match='samples'):
        solve(solver, Recording(still, recording.path, recording.machine))
    process = solver._process
    assert solve(solver, recording).run_id
    assert solver._process is process


def test_calibration_that_is_given_up_ends_at_once_and_the_next_one_works(solver, recording):
    def given_up(stage, fraction):
        raise Cancelled('not wanted any more')

    solver.begin()
    process = solver._process
    with pytest.raises(Cancelled):
        solve(solver, recording, given_up)
    assert process.poll() == -signal.SIGKILL
    assert solve(solver, recording).run_id


def test_process_that_the_system_ends_is_told_of_and_begun_anew(solver, recording):
    def killed(stage, fraction):
        os.kill(solver._process.pid, signal.SIGKILL)

    with pytest.raises(OtfError, match='ended by the system'):
        solve(solver, recording, killed)
    assert solve(solver, recording).run_id


def test_defect_in_the_process_is_told_with_its_traceback_and_the_process_goes_on(
    solver, recording
):
    with pytest.raises(ChildError, match='Traceback') as told:
        solve(solver, replace(recording, machine=None))
    assert internal_error(told.value).startswith('internal error: AttributeError')
    process = solver._process
    assert solve(solver, recording).run_id and solver._process is process


def test_process_ends_with_its_owner(solver):
    solver.begin()
    process = solver._process
    time.sleep(0.1)
    solver._end.close()  # as the system does for a node that is killed
    assert process.wait(timeout=20.0) == 0

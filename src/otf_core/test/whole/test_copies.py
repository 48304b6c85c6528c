# SPDX-License-Identifier: Apache-2.0
"""Copies of the process save time, and change no bit of a calibration and no error."""

import os
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from contradiction_cells import recorded, stepped
from core_cells import some_machine
from effect_cells import applied, some_plan

from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import CalibrationConfig, SimulationConfig
from otf_core.errors import InputError
from otf_core.pieces.runs import Recording
from otf_core.sim.cell import simulate

CONFIG = CalibrationConfig(piece_length=0.02)
COPIES = sys.platform == 'linux' and len(os.sched_getaffinity(0)) > 1
pytestmark = pytest.mark.skipif(not COPIES, reason='no second process here')


def alone(*recordings):
    """Outcome of a calibration in a thread, where no copies are made."""
    found = []

    def work():
        try:
            found.append(calibrate_recordings(recordings, CONFIG))
        except InputError as error:
            found.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    return found[0]


def lost_motion():
    """A run of a machine with backlash, on a path that drives lines forward and back."""
    machine = some_machine('w-Y-b-X-Z-t', pitch=0.1)
    plan = some_plan(machine, passes=2)
    effects = [applied('backlash', B_X=5e-6, B_Y=-3e-6)]
    run = simulate(machine, plan, SimulationConfig(seed=5, rate=60), None, effects)
    return Recording(run.samples, plan.path, machine)


@pytest.mark.parametrize(('make', 'runs', 'reversal'), [
    (recorded, 1, 'none'),
    (lambda: stepped(recorded(), (3e-5, 0.0, -2e-5)), 2, 'none'),
    (lost_motion, 1, 'constant'),
], ids=['as it is', 'repaired where the tracker moved', 'with a reversal'])  # fmt: skip
def test_tables_are_those_without_copies_bit_by_bit(make, runs, reversal):
    recording = make()
    here, there = calibrate_recordings([recording], CONFIG), alone(recording)
    assert (len(here.runs), here.reversal.model) == (runs, reversal)
    assert here.warnings == there.warnings and here.reversal.evidence == there.reversal.evidence
    assert here.covariance.tobytes() == there.covariance.tobytes()
    for name, table in there.tables.motions.items():
        np.testing.assert_array_equal(here.tables.motions[name].value, table.value)
        np.testing.assert_array_equal(here.tables.motions[name].u, table.u)
    pairs = zip(here.runs, there.runs, strict=True)
    assert all(a.residual.tobytes() == b.residual.tobytes() for a, b in pairs)


def test_runs_are_refused_in_the_same_words():
    one = recorded()
    other = replace(recorded(seed=2), name='run 2')
    with pytest.raises(InputError) as raised:
        calibrate_recordings([one, other], CONFIG)
    assert str(raised.value) == str(alone(one, other))


def test_contradictions_are_reported_before_a_solution_that_fails(monkeypatch):
    def fails(*_):
        raise np.linalg.LinAlgError('singular')

    monkeypatch.setattr('otf_core.calibration.calibrate.solve_with_reversal', fails)
    with pytest.raises(InputError, match='not of one machine'):
        calibrate_recordings([recorded(), replace(recorded(seed=2), name='run 2')], CONFIG)
    with pytest.raises(np.linalg.LinAlgError, match='singular'):
        calibrate_recordings([recorded()], CONFIG)

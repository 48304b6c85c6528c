# SPDX-License-Identifier: Apache-2.0
"""Reversal as part of the solution: recovered, chosen on held-out legs, honest where blind."""

import numpy as np
import pytest
from core_cells import (
    grid_error,
    some_machine,
)
from effect_cells import applied, some_plan

from otf_core.calibration.calibrate import calibrate, calibrate_recordings
from otf_core.config import CalibrationConfig, SimulationConfig
from otf_core.effects import REGISTRY
from otf_core.effects.state import state_of_travel
from otf_core.model.machine import AXES
from otf_core.pieces.runs import Recording
from otf_core.sim.cell import simulate

CHAIN = 'w-Y-b-X-Z-t'
BACKLASH = {'B_X': 5e-6, 'B_Y': -3e-6, 'B_Z': 2e-6}
TABLES = {'EYX_1': 6e-6, 'EZY_0': 4e-6, 'EXX_2': 3e-6, 'EBX_0': 2e-5}


def cell(passes=2, seed=31, **effects):
    """Machine, plan and simulated run of a small cell with effects."""
    machine = some_machine(CHAIN, pitch=0.1)
    plan = some_plan(machine, passes=passes)
    some = [applied(name, **parameters) for name, parameters in effects.items()]
    return machine, plan, simulate(machine, plan, SimulationConfig(seed=seed, rate=60), None, some)


def solved(of, reversal='auto'):
    machine, plan, run = of
    return calibrate(
        run.samples, plan.path, machine, CalibrationConfig(reversal=reversal, piece_length=0.016)
    )


@pytest.fixture(scope='module')
def backlash():
    """Cell with backlash."""
    return cell(backlash=BACKLASH)


@pytest.fixture(scope='module')
def chosen(backlash):
    """Calibration of it, model chosen."""
    return solved(backlash)


@pytest.fixture(scope='module')
def along_the_axis():
    """Calibration of a cell whose reversal changes along the axes, model chosen."""
    return solved(cell(direction_dependent_tables=TABLES))


def test_backlash_is_found_as_constants_within_their_uncertainty(chosen):
    assert chosen.reversal.model == 'constant'
    for name, table in chosen.reversal.motions.items():
        own = name[1] == name[2]
        true = BACKLASH[f'B_{name[2]}'] if own else 0.0
        assert np.ptp(table.value) == 0
        if table.identifiable:
            assert np.all(np.abs(table.value - true) < 4 * table.u), name


def test_axes_held_on_the_side_of_their_last_travel_are_recognised(chosen):
    assert not chosen.reversal.held
    held = cell(backlash=BACKLASH | {'held': 1.0})
    result = solved(held)
    assert (result.reversal.model, result.reversal.held) == ('constant', True)
    for name, true in (('EXX', 5e-6), ('EYY', -3e-6), ('EZZ', 2e-6)):
        table = result.reversal.motions[name]
        assert np.abs(table.value - true).max() < 4 * table.u.max()
    assert grid_error(result.tables, held[2].truth)[1] < (
        0.5 * grid_error(solved(held, 'none').tables, held[2].truth)[1]
    )


def test_reversal_that_changes_along_the_axis_is_found_within_its_uncertainty(along_the_axis):
    assert along_the_axis.reversal.model == 'tables'
    effect = REGISTRY['direction_dependent_tables']
    machine = along_the_axis.tables.machine
    for name in ('EXX', 'EYX', 'EZY', 'EBX', 'EXZ'):
        table = along_the_axis.reversal.motions[name]
        q = np.tile(machine.lower, (len(table.position), 1))
        q[:, AXES.index(name[2])] = table.position
        own = {k: v for k, v in TABLES.items() if k.startswith(name)}
        if name == 'EBX':  # the lever is T and z
            true = np.full(len(q), TABLES['EBX_0'])
        else:
            state = state_of_travel(machine, q, np.ones_like(q))
            moved = 2.0 * effect.displacement(state, own) if own else np.zeros_like(q)
            true = moved[:, AXES.index(name[1])]
        assert np.all(np.abs(table.value - true) < 4 * table.u), name


def test_servo_mismatch_at_two_feeds_is_not_taken_for_reversal():
    result = solved(cell(servo_mismatch={'T_X': 4e-5, 'T_Y': -2e-5}))
    assert result.reversal.model == 'none'
    late = {one.axis: one.value for one in result.lags}
    assert late['X'] - late.get('Y', 0.0) == pytest.approx(6e-5, abs=5e-6)


def test_stops_show_backlash_by_their_direction_of_approach():
    machine = some_machine(CHAIN, pitch=0.1)
    plan = some_plan(machine, corner_dwell=0.3)
    run = simulate(
        machine, plan, SimulationConfig(seed=31, rate=60), None, [applied('backlash', **BACKLASH)]
    )
    recording = Recording(run.samples, plan.path, machine)
    result = calibrate_recordings([recording], method='standstill')
    assert result.reversal.model == 'constant'
    for axis in AXES:
        table = result.reversal.motions[f'E{axis}{axis}']
        assert np.all(np.abs(table.value - BACKLASH[f'B_{axis}']) < 4 * table.u)

# SPDX-License-Identifier: Apache-2.0
"""Drifts of what is switched on and off: the functions, files, and the search for the moments."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import yaml
from core_cells import record, small_plan, some_machine
from effect_cells import driven_state
from engine_cells import LIMIT

from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.residual_rows import build_rows
from otf_core.diagnosis.engine.search import search, tried_effects
from otf_core.diagnosis.engine.time_courses import DECOY_NAMES, DECOYS, courses_tried
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.action import vector
from otf_core.effects.effects_yaml import effects_from_data, effects_to_data
from otf_core.effects.free import declare_switching
from otf_core.effects.free_form import FreeForm
from otf_core.effects.inputs import Switching, known_input
from otf_core.errors import ConfigError
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.sim.cell import random_tables
from otf_core.solving.joint import solve_jointly
from otf_core.solving.unknowns import layout, linear_bases

DRIFT = REGISTRY['thermal_structure_drift']


def heated(time, on, lag):
    """Warmth (n,) of a mass that takes up a share dt / lag of what it lacks at every step."""
    warmth = np.zeros(len(time))
    for k, step in enumerate(np.diff(time), start=1):
        warmth[k] = warmth[k - 1] + step / lag * (on[k - 1] - warmth[k - 1])
    return warmth


# ---------------------------------------------------------------- what they compute


def test_function_is_what_a_mass_does_that_is_heated_now_and_then():
    time = np.linspace(0.0, 300.0, 60001)
    on = ((time >= 20.0) & (time < 110.0)) | (time >= 190.0)
    found = Switching(40.0, (20.0, 110.0, 190.0)).functions(time, 1)
    assert np.allclose(found[:, 0], 1.0)
    assert np.allclose(found[:, 1], heated(time, on, 40.0), atol=2e-4)


def test_later_switches_have_functions_of_their_own():
    at = np.array([0.0, 50.0, 90.0])
    found = Switching(0.0, (10.0, 60.0)).functions(at, 2)
    assert found.tolist() == [[1, 0, 0], [1, 1, 0], [1, 0, 1]]


def test_name_says_lag_and_moments():
    one = Switching(43.5, (0.0, 120.25, 300.0))
    assert Switching.of(one.name) == one and known_input(one.name)


@pytest.mark.parametrize(
    'name', ['switched:', 'switched:5', 'switched:-1@0', 'switched:5@3,2', 'switched:5@-1,2',
             'switched:nan@0', 'switched:5@0,x', 'switched:5@0,inf', 'time'],
)  # fmt: skip
def test_what_is_no_such_name_is_none(name):
    assert Switching.of(name) is None
    assert known_input(name) == (name == 'time')


# ---------------------------------------------------------------- files


@pytest.mark.parametrize('order', [1, 3])
def test_file_keeps_a_drift_that_switches(order):
    state, machine = driven_state(), some_machine('w-Y-b-X-Z-t')
    free = declare_switching(vector, Switching(8.0, (2.0, 20.0, 41.5)), order)
    form = FreeForm.bound(DRIFT, free, [state])
    given = AppliedEffect(form, {'Z_1': 6e-6, f'X_{order}': -2e-6})
    text = yaml.safe_dump(effects_to_data([given], machine))
    (again,) = effects_from_data(yaml.safe_load(text), 'file', machine)
    moved = form.displacement(state, given.parameters)
    assert np.array_equal(again.effect.displacement(state, again.parameters), moved)
    on = ((state.time > 2.0) & (state.time < 20.0)) | (state.time > 41.5)
    assert not np.any(moved[state.time < 2.0]) and np.ptp(moved[on, 2]) > 3e-6


def test_tables_over_such_an_input_are_refused():
    entry = {
        'effect': 'empirical', 'acts_as': 'vector', 'nodes': {'switched:5@0,9': [0.0, 10.0]},
        'table': {'X': [0.0, 1e-6]},
    }  # fmt: skip
    with pytest.raises(ConfigError, match='not an input of a table; write time'):
        effects_from_data([entry], 'file', some_machine())


# ---------------------------------------------------------------- the search


@functools.cache
def one_run():
    """Rows of one run."""
    machine = some_machine(pitch=0.1)
    plan = small_plan(machine)
    truth = random_tables(machine, 2e-5, np.random.default_rng(3))
    driven = record(machine, plan, rate=50.0)
    config = CalibrationConfig(piece_length=0.024)
    recording = Recording(driven.measured(truth, seed=0), plan.path, machine)
    runs, nodes = prepare_runs([recording], config)
    done = solve_jointly(
        runs, layout(linear_bases(machine, nodes)), config, lambda stage, fraction: None
    )
    return build_rows(runs, done, LIMIT)


def found_of(course, size, seed=1):
    """Causes found in noise and a shift along one direction by a course in shares of the run."""
    rows = one_run()
    (state,), (run,) = rows.states, rows.done.runs
    moved = (size * course(state.time / state.end))[:, None] * [0.3, 0.2, 1.0]
    across = np.einsum('cpk,pk->cp', run.system.axes, moved).ravel()
    white = np.random.default_rng([20260801, seed]).standard_normal(len(rows.deviation))
    plain = np.empty_like(white)
    for (low, high), factors in zip(
        rows.whiteners[0].bounds, rows.whiteners[0].factors, strict=True
    ):
        part, out = rows.by_run(white)[0], rows.by_run(plain)[0]
        for component, factor in enumerate(factors):
            out[component, low:high] = factor @ part[component, low:high]
    spoiled = replace(rows, plain_deviation=plain + across)
    effects = [DRIFT, REGISTRY['tracker_pose_drift'], *DECOYS]
    tried, _ = tried_effects(spoiled, effects, {})
    return search(spoiled, {**tried, **courses_tried(spoiled, effects)})[0]


def spindle(share):
    fine = np.linspace(0.0, 1.0, 4001)
    on = (fine < 0.22) | ((fine > 0.5) & (fine < 0.74))
    return np.interp(share, fine, heated(fine, on, 0.12))


def test_drift_of_a_spindle_that_is_on_and_off_is_named_with_its_moments():
    (cause,) = found_of(spindle, 12e-6)
    assert cause.option.effect.name == 'thermal_structure_drift'
    (name,) = cause.option.effect.form.inputs
    switching, end = Switching.of(name), one_run().states[0].end
    assert np.allclose(np.array(switching.moments) / end, [0.0, 0.22, 0.5, 0.74], atol=0.02)
    assert switching.lag / end == pytest.approx(0.12, rel=0.2)


@pytest.mark.parametrize(
    'course',
    [
        lambda s: (s > 0.3) + 0.7 * (s > 0.62),
        lambda s: 1.0 * (s > 0.21) - 1.3 * (s > 0.47) + 0.8 * (s > 0.8),
        lambda s: np.sin(2 * np.pi * 3.3 * s + 1.0),
    ],
    ids=['two jolts', 'three jolts', 'swing'],
)
def test_what_jumps_or_swings_is_no_drift(course):
    causes = found_of(course, 6e-6)
    assert causes[0].option.effect.name in DECOY_NAMES

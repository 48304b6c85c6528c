# SPDX-License-Identifier: Apache-2.0
"""The whole diagnosis on small simulated cells: what is named, what is not, what is written."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.blind.unknown_effects import UNKNOWN_EFFECTS
from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.diagnosis.complete import diagnose
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.effects_yaml import read_effects
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.tables import load_tables
from otf_core.pieces.runs import Recording
from otf_core.planning.creator import plan_path
from otf_core.reports.diagnosis import write_diagnosis
from otf_core.sim.cell import simulate
from otf_core.sim.twin import twin_recording

MACHINE = some_machine(pitch=0.05)
PLAN = plan_path(MACHINE, PlannerConfig(feed=0.15, corner_dwell=0.4))
BACKLASH = AppliedEffect(REGISTRY['backlash'], {'B_X': 6e-6, 'B_Y': -4e-6})
JOLT = AppliedEffect(
    UNKNOWN_EFFECTS['unknown_machine_step'], {'t0': 90.0, 'A_X': 4e-6, 'A_Z': -3e-6}
)


def recording(effects=(), seed=411):
    config = SimulationConfig(seed=seed, rate=100.0)
    return Recording(simulate(MACHINE, PLAN, config, None, effects).samples, PLAN.path, MACHINE)


def diagnosed(run):
    return diagnose([run], ['run'], twin_recording)


@pytest.fixture(scope='module')
def clean():
    return diagnosed(recording())


@pytest.fixture(scope='module')
def with_backlash():
    return diagnosed(recording([BACKLASH]))


@pytest.fixture(scope='module')
def folder(with_backlash, tmp_path_factory):
    path = tmp_path_factory.mktemp('diagnosis')
    write_diagnosis(*with_backlash, path)
    return path


def test_run_without_effect_has_no_gap_and_no_cause(clean):
    answer, _ = clean
    assert (answer.verdict, answer.causes) == ('none', ())


def test_backlash_is_named_on_its_axes_with_its_size(with_backlash):
    answer, _ = with_backlash
    assert answer.verdict == 'explained'
    assert [c.effect for c in answer.causes] == ['backlash']
    cause = answer.causes[0]
    assert set(cause.axes) == {'X', 'Y'}
    for name, true in BACKLASH.parameters.items():
        assert abs(cause.parameters[name] - true) < 3 * cause.u[name]
        assert cause.u[name] < 0.2 * abs(true)


def test_gap_shrinks_to_little_where_the_cause_is_known(with_backlash):
    gap = with_backlash[0].gap
    assert gap.after_um < 0.4 * gap.before_um
    low, high = gap.shrink_interval_percent
    assert low <= gap.shrink_percent <= high


def test_tables_with_the_cause_taken_off_are_nearer_to_those_without_it(folder, clean):
    points = lattice(MACHINE)
    wanted = clean[1].findings.rows.tables

    def distance(name):
        tables = load_tables(folder / name / 'error_tables.json').tables
        change = displacement(tables, points) - displacement(wanted, points)
        return mean_length(without_rigid_motion(change, points))

    assert distance('calibration_with_effects') < 0.5 * distance('calibration_plain')


def test_what_was_found_can_be_simulated(folder, with_backlash):
    (again,) = read_effects(folder / 'effects.yaml', MACHINE)
    assert again.effect.name == 'backlash'
    found = with_backlash[0].causes[0].parameters
    assert again.parameters == {n: pytest.approx(v) for n, v in found.items()}


def test_jolt_is_unknown_and_described():
    answer, _ = diagnosed(recording([JOLT]))
    assert (answer.verdict, answer.causes) == ('unknown', ())
    assert 'step' in answer.unexplained_where


def test_drifts_have_coefficients_of_their_own_in_every_run(clean):
    rows = clean[1].findings.rows
    twice = replace(
        rows,
        runs=rows.runs * 2,
        states=rows.states * 2,
        done=replace(rows.done, runs=rows.done.runs * 2),
    )
    for name, own in (('tracker_pose_drift', True), ('backlash', False)):
        effect = REGISTRY[name]
        shape = effect.shapes(rows.states[0])[0]
        one, two = rows.plain_columns(effect, shape), twice.plain_columns(effect, shape)
        names = twice.terms(effect, shape).names
        assert two.shape == (2 * len(one), len(names)) and len(set(names)) == len(names)
        assert len(names) == one.shape[1] * (1 + own)
        assert np.array_equal(two[len(one) :, -one.shape[1] :], one)
        assert own is not np.any(two[: len(one), -one.shape[1] :])

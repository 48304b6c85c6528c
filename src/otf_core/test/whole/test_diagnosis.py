# SPDX-License-Identifier: Apache-2.0
"""The whole diagnosis on small simulated cells: what is named, what is not, what is written."""

import functools
import re
from dataclasses import replace

import numpy as np
import pytest
from core_cells import some_machine
from nameless_effects import nameless_ball_passage, nameless_jolt

from otf_core.calibration.calibrate import calibrate_recordings, solve_recordings
from otf_core.config import CalibrationConfig, PlannerConfig, SimulationConfig
from otf_core.diagnosis import diagnose as diagnosis
from otf_core.diagnosis.diagnose import diagnose
from otf_core.diagnosis.engine.residual_rows import build_rows
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.effects_yaml import read_effects
from otf_core.model.chain import displacement
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.motions import MOTIONS
from otf_core.model.observation import Samples
from otf_core.pieces.runs import Recording
from otf_core.planning.path_creation import plan_path
from otf_core.prediction.calibration_document import load_tables
from otf_core.reports.diagnosis import write_diagnosis
from otf_core.sim.cell import simulate

MACHINE = some_machine(pitch=0.05)
PLAN = plan_path(MACHINE, PlannerConfig(passes=1, levels=2, feed=0.15, corner_dwell=0.4))
BACKLASH = AppliedEffect(REGISTRY['backlash'], {'B_X': 6e-6, 'B_Y': -4e-6})
GROWTH = AppliedEffect(
    REGISTRY['thermal_axis_expansion'], {'tau': 200.0, 'until': 0.0, 'S_X': 40e-6, 'S_Y': 25e-6}
)
JOLT = AppliedEffect(nameless_jolt, {'t0': 90.0, 'A_X': 4e-6, 'A_Z': -3e-6})
PERIOD = 0.0137
BALLS = AppliedEffect(nameless_ball_passage, {'p': PERIOD, 'A_X': 12e-6, 'A_Z': 0.0, 'A_Y': 0.0})

EFFECTS = {
    'none': [], 'backlash': [BACKLASH], 'growth': [GROWTH], 'jolt': [JOLT], 'balls': [BALLS]
}  # fmt: skip


@functools.cache
def recording(name='none', seed=411):
    effects = EFFECTS[name]
    config = SimulationConfig(seed=seed, rate=100.0)
    return Recording(simulate(MACHINE, PLAN, config, None, effects).samples, PLAN.path, MACHINE)


@functools.cache
def solved_growth():
    return solve_recordings([recording('growth')], CalibrationConfig())


def with_burst(run):
    """The run with half a second of samples that are 60 um off, across a line."""
    xyz = run.samples.xyz.copy()
    xyz[20_000:20_050] += [0.0, 0.0, 60e-6]
    return replace(run, samples=Samples(run.samples.stamp_ns, xyz))


@functools.cache
def diagnosed(name='none', burst=False):
    run = recording(name)
    return diagnose([with_burst(run) if burst else run])


def same_tables(a, b):
    return all(
        np.array_equal(a.motions[n].value, b.motions[n].value)
        and np.array_equal(a.motions[n].u, b.motions[n].u)
        for n in MOTIONS
    )


@pytest.fixture(scope='module')
def clean():
    return diagnosed()


@pytest.fixture(scope='module')
def with_backlash():
    return diagnosed('backlash')


@pytest.fixture(scope='module')
def growing():
    return diagnosed('growth')


@pytest.fixture(scope='module')
def folder(growing, tmp_path_factory):
    path = tmp_path_factory.mktemp('diagnosis')
    write_diagnosis(growing, path)
    return path


def test_run_without_effect_has_no_gap_and_no_cause(clean):
    assert (clean.verdict, clean.causes) == ('none', ())


def test_backlash_is_named_on_its_axes_with_its_size(with_backlash):
    answer = with_backlash
    assert answer.verdict == 'explained'
    assert [c.effect for c in answer.causes] == ['backlash']
    cause = answer.causes[0]
    assert set(cause.axes) == {'X', 'Y'}
    for name, true in BACKLASH.parameters.items():
        assert abs(cause.parameters[name] - true) < 3 * cause.u[name]
        assert cause.u[name] < 0.2 * abs(true)


def test_gap_shrinks_to_little_where_the_cause_is_known(with_backlash):
    gap = with_backlash.gap
    assert gap.after_um < 0.4 * gap.before_um
    low, high = gap.shrink_interval_percent
    assert low <= gap.shrink_percent <= high


def test_tables_with_the_cause_taken_off_are_nearer_to_those_without_it(folder, clean):
    points = lattice(MACHINE)
    wanted = clean.calibration.tables

    def distance(name):
        tables = load_tables(folder / name / 'error_tables.json').tables
        change = displacement(tables, points) - displacement(wanted, points)
        return mean_length(without_rigid_motion(change, points))

    assert distance('calibration_with_effects') < 0.5 * distance('calibration_plain')


def test_what_was_found_can_be_simulated(folder, growing):
    (again,) = read_effects(folder / 'effects.yaml', MACHINE)
    assert again.effect.name == growing.causes[0].effect == 'thermal_axis_expansion'
    found = growing.causes[0].parameters
    assert again.parameters == {n: pytest.approx(v) for n, v in found.items()}


def test_diagnosis_stands_on_the_calibration_that_the_user_gets(with_backlash):
    given = calibrate_recordings([recording('backlash')])
    assert with_backlash.calibration.plain.run_id == given.run_id
    assert same_tables(with_backlash.calibration.plain.tables, given.tables)


def test_least_squares_leave_no_more_than_the_calibration(growing):
    """Its weights take what it does not model for noise."""
    left = 1e6 * growing.calibration.plain.fit.residual_rms
    assert 0.8 * left < growing.gap.measured_um < left


def test_reversal_is_in_the_tables_and_a_cause_as_well(with_backlash):
    assert with_backlash.calibration.plain.reversal.model == 'constant'
    # the gap is that of tables without it
    fit = with_backlash.calibration.plain.fit
    assert with_backlash.gap.measured_um > 1.2e6 * fit.residual_rms


def test_burst_of_bad_samples_is_in_neither_gap_nor_tables(clean):
    found = diagnosed(burst=True)
    assert (found.verdict, found.causes) == ('none', ())
    assert found.gap.measured_um == pytest.approx(clean.gap.measured_um, rel=0.01)
    points = lattice(MACHINE)
    change = displacement(found.calibration.plain.tables, points) - displacement(
        clean.calibration.plain.tables, points
    )
    assert mean_length(without_rigid_motion(change, points)) < 0.1e-6


def test_jolt_is_unknown_and_described():
    answer = diagnosed('jolt')
    assert (answer.verdict, answer.causes) == ('unknown', ())
    assert 'step' in answer.unexplained_where


def test_what_repeats_along_an_axis_and_displaces_across_it_is_told_with_its_period():
    answer = diagnosed('balls')
    assert (answer.verdict, answer.causes) == ('unknown', ())
    assert answer.unnamed.depends_on == ('x',)
    (found,) = re.findall(r'over and over every (\S+) mm', answer.unnamed.words)
    assert float(found) == pytest.approx(1e3 * PERIOD, rel=2e-3)
    assert answer.unnamed.after_um < 0.3 * answer.unnamed.before_um


def test_drifts_have_coefficients_of_their_own_in_every_run():
    solved = solve_recordings([recording()], CalibrationConfig())
    rows = build_rows(*solved.solution.plain, CalibrationConfig().unidentifiable_above)
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


def test_runs_of_many_pieces_are_diagnosed_in_longer_ones(monkeypatch):
    config, solved = CalibrationConfig(), solved_growth()
    monkeypatch.setattr(diagnosis, 'MOST_PIECES', len(solved.runs[0].pieces) // 2)
    length = diagnosis._piece_length(solved.runs, config)
    assert length == pytest.approx(2.0 * config.piece_length, rel=0.01)

    whole, coarse = (
        diagnosis._without_reversal([recording('growth')], solved, config, own)
        for own in (config.piece_length, length)
    )
    assert len(coarse.runs[0].pieces) < 0.65 * len(whole.runs[0].pieces)
    assert coarse.solution.unknowns is whole.solution.unknowns
    sizes = [float(np.sqrt(np.mean(o.solution.runs[0].system.deviation ** 2)))
             for o in (whole, coarse)]  # fmt: skip
    assert sizes[1] == pytest.approx(sizes[0], rel=0.02)


def test_pieces_are_not_made_longer_than_a_third_of_the_distance_between_nodes(monkeypatch):
    config, solved = CalibrationConfig(), solved_growth()
    monkeypatch.setattr(diagnosis, 'MOST_PIECES', 1)
    assert diagnosis._piece_length(solved.runs, config) == pytest.approx(0.05 / 3.0)
    monkeypatch.setattr(diagnosis, 'MOST_PIECES', len(solved.runs[0].pieces))
    assert diagnosis._piece_length(solved.runs, config) == config.piece_length

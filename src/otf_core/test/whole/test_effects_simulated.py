# SPDX-License-Identifier: Apache-2.0
"""Effects in simulated runs: added as stated, written and read again, found again by the fit."""

import dataclasses

import numpy as np
import pytest
import yaml
from cli_cells import words_of
from core_cells import some_machine
from effect_cells import (
    DISPLACING,
    EXAMPLES,
    applied,
    coefficients_of,
    driven_state,
    shape_of,
    some_plan,
    state_of,
)

from otf_core import cli
from otf_core.bags.bag import read_bag
from otf_core.config import CalibrationConfig, SimulationConfig
from otf_core.effects import REGISTRY
from otf_core.effects.effects_yaml import read_effects, write_effects
from otf_core.effects.state import state_on_path
from otf_core.errors import ConfigError
from otf_core.model.frames import RigidTransform
from otf_core.model.plan import Plan
from otf_core.noise.noise_model import NoiseModel
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.sim.cell import simulate
from otf_core.sim.drive import drives_of
from otf_core.sim.effects import changed_noise
from otf_core.solving.joint import solve_jointly, tables_of
from otf_core.solving.normal import sum_groups
from otf_core.solving.solution import TIE_BREAK, smoothness
from otf_core.solving.unknowns import layout, linear_bases
from otf_core.solving.whitener import Whitener

displacing = pytest.mark.parametrize('name', DISPLACING)
CONFIG = SimulationConfig(rate=100.0, seed=61)


@pytest.fixture(scope='module')
def machine():
    return some_machine('w-Y-b-X-Z-t')


@pytest.fixture(scope='module')
def plan(machine):
    return some_plan(machine)


@pytest.fixture(scope='module')
def plain(machine, plan):
    return simulate(machine, plan, CONFIG)


# ---------------------------------------------------------------- state of the samples


def test_state_describes_the_drive():
    state = driven_state(rate=200.0)
    velocity = np.gradient(state.q, state.time, axis=0)
    steady = (state.from_corner > 0.02) & (state.to_corner > 0.02)
    expected = state.speed[:, None] * state.direction
    np.testing.assert_allclose(velocity[steady], expected[steady], atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(state.direction, axis=1), 1.0)
    still = state.speed == 0
    assert 0.02 < still.mean() < 0.5
    assert state.speed.max() == pytest.approx(0.25)


def test_standing_samples_keep_the_direction_of_the_leg_just_driven():
    machine = some_machine()
    points = np.array([(0, 0, 0), (0.1, 0, 0), (0.1, 0, 0), (0.2, 0, 0), (0.2, 0.1, 0)]) - 0.0
    plan = Plan.along(points, np.full(4, 0.1), np.full(5, 1.0))
    drives = drives_of(machine, plan, 1.0)
    time = np.arange(0, drives[0].duration, 0.01)
    leg = drives[0].motion(time).leg
    pose = RigidTransform(np.eye(3), np.array([-1.0, 0, 0]))
    state = state_of(driven_state().tables, drives, time, time, pose)
    expected = np.where((leg == 2)[:, None], [0.0, 1, 0], [1.0, 0, 0])
    np.testing.assert_array_equal(state.direction, expected)
    assert np.all(state.speed[time < 1.0] == 0) and leg[0] == 0
    # a repeated point and a stop on the straight are no corners
    at_stop = np.argmin(np.abs(state.q[:, 0] - 0.1))
    assert state.from_corner[at_stop] == pytest.approx(0.1, abs=1e-3)
    assert state.to_corner[at_stop] == pytest.approx(0.1, abs=1e-3)
    np.testing.assert_array_equal(state.after[leg < 2], np.tile([0.0, 1, 0], ((leg < 2).sum(), 1)))


@displacing
def test_run_with_an_effect_differs_by_its_displacement(name, machine, plan, plain):
    run = simulate(machine, plan, CONFIG, effects=[applied(name)])
    time = plain.samples.time / (1 + CONFIG.clock_drift)
    state = state_of(plain.truth, plain.drives, time, plain.samples.time, plain.pose)
    expected = REGISTRY[name].displacement(state, EXAMPLES[name])
    moved = (run.samples.xyz - plain.samples.xyz) @ plain.pose.rotation.T
    assert np.abs(expected).max() > 1e-6
    # noise grows with the range, so a little of it changes too
    np.testing.assert_allclose(moved, expected, atol=2e-10)
    np.testing.assert_array_equal(run.samples.stamp_ns, plain.samples.stamp_ns)


def test_displacement_in_a_wrong_unit_is_refused(machine, plan):
    with pytest.raises(ConfigError, match=r'backlash: displaces .* B_X = 5 m'):
        simulate(machine, plan, CONFIG, effects=[applied('backlash', B_X=5.0)])


# ---------------------------------------------------------------- noise


def noise_of(machine, plan, config=CONFIG, **parameters):
    """Noise of range and across the beam, over what is specified."""
    silent = applied('tracker_noise', level_range=0.0, level_angle=0.0)
    true = simulate(machine, plan, config, effects=[silent]).samples.xyz
    noisy = applied('tracker_noise', **parameters)
    noise = simulate(machine, plan, config, effects=[noisy]).samples.xyz - true
    distance = np.linalg.norm(true, axis=1, keepdims=True)
    along = np.sum(noise * true / distance, axis=1)
    across = (noise - along[:, None] * true / distance) / distance
    return along / machine.tracker.u_range, across / machine.tracker.u_angle


def test_noise_levels_are_factors(machine, plan):
    along, across = noise_of(machine, plan, level_range=3.0, level_angle=0.5)
    assert along.std() == pytest.approx(3.0, rel=0.1)
    assert np.sqrt(np.mean(np.sum(across**2, axis=1)) / 2) == pytest.approx(0.5, rel=0.1)


def test_noise_keeps_its_size_with_heavy_tails(machine, plan):
    along, _ = noise_of(machine, plan, correlated_share=0.0, dof=5.0)
    normal, _ = noise_of(machine, plan, correlated_share=0.0)
    assert along.std() == pytest.approx(1.0, rel=0.1) == normal.std()
    assert np.abs(along).max() > 1.5 * np.abs(normal).max()


def test_noise_colour_is_as_stated(machine, plan):
    along, _ = noise_of(machine, plan, correlated_share=0.8, correlation_time=0.5)
    lag = 50  # half a second
    correlation = np.mean(along[lag:] * along[:-lag]) / np.mean(along**2)
    assert correlation == pytest.approx(0.8 * np.exp(-1), abs=0.12)


def test_noise_not_stated_stays_as_it_is(machine, plan, plain):
    run = simulate(machine, plan, CONFIG, effects=[applied('tracker_noise', level_range=1.0)])
    np.testing.assert_array_equal(run.samples.xyz, plain.samples.xyz)
    noise = NoiseModel.from_spec(machine.tracker)
    found = changed_noise(noise, [applied('tracker_noise', correlated_share=0.1)])
    for part, before in zip(found, noise, strict=True):
        assert part.white_share == pytest.approx(0.9)
        assert dataclasses.replace(part, white=before.white) == before


# ---------------------------------------------------------------- effects.yaml


def test_written_effects_state_their_units(machine, tmp_path):
    write_effects(tmp_path / 'e.yaml', [applied('thermal_axis_expansion')], machine)
    data = yaml.safe_load((tmp_path / 'e.yaml').read_text())
    assert data[0]['units'] == {'tau': 's', 'S_X': 'm/m', 'S_Z': 'm/m'}


WRONG = {
    'effect: backlash': 'expected a list',
    '[backlash]': 'entry 1: expected a mapping',
    '[{parameters: {}}]': 'effect: missing',
    '[{effect: wobble, parameters: {}}]': "entry 1: effect: 'wobble' is unknown; possible: backl",
    '[{effect: backlash}]': 'parameters: missing',
    '[{effect: backlash, parameters: 3}]': 'backlash: parameters: expected names and values',
    '[{effect: backlash, parameters: {B_Q: 1e-6}}]': 'backlash: B_Q: unknown; possible: held, B_X',
    '[{effect: backlash, parameters: {B_X: 5 um}}]': "backlash: B_X: expected a plain.*'5 um'",
    '[{effect: backlash, parameters: {B_X: .nan}}]': 'backlash: B_X: expected a plain number',
    '[{effect: backlash, parameters: {B_X: true}}]': 'backlash: B_X: expected a plain number',
    '[{effect: backlash, parameters: {}, axes: [X]}]': 'axes: unknown key',
    '[{effect: backlash, parameters: {B_X: 1}, units: {B_X: um}}]': "B_X: 'um'; its unit is 'm'",
    '[{effect: backlash, parameters: {B_X: 1}, units: {B_Y: m}}]': 'units: B_Y: not among',
    '[{effect: cyclic_error, parameters: {S_X: 1e-6}}]': 'cyclic_error: period: missing',
    '[{effect: cyclic_error, parameters: {period: 0}}]': 'period: 0.0 is out of range',
    '[{effect: backlash, parameters: {B_X: 1, B_X: 2}}]': 'appears twice',
    '[{effect: tracker_noise, parameters: {dof: 1}}]': 'tracker_noise: dof: 1.0 is out of range',
}


@pytest.mark.parametrize('text', WRONG, ids=range(len(WRONG)))
def test_wrong_effects_files_say_what_is_wrong(text, machine, tmp_path):
    file = tmp_path / 'effects.yaml'
    file.write_text(text)
    with pytest.raises(ConfigError, match=WRONG[text]) as caught:
        read_effects(file, machine)
    assert str(caught.value).startswith(str(file)), caught.value


def test_command_line_adds_effects(machine, tmp_path):
    (tmp_path / 'machine.yaml').write_text(yaml.safe_dump(machine.to_dict()))
    (tmp_path / 'e.yaml').write_text('[{effect: tracker_range_offset, parameters: {c: 1e-4}}]')
    (tmp_path / 'wrong.yaml').write_text('[{effect: backlash, parameters: {B_W: 1e-4}}]')
    quick = words_of({'passes': 1, 'levels': 2, 'feed': 0.5, 'rate': 20})
    common = ['simulate', '--machine', str(tmp_path / 'machine.yaml'), *quick]
    effects = ['--effects', str(tmp_path / 'e.yaml')]
    assert cli.main([*common, '--out', str(tmp_path / 'plain')]) == 0
    assert cli.main([*common, *effects, '--out', str(tmp_path / 'moved')]) == 0
    plain, moved = (read_bag(tmp_path / n).samples.xyz for n in ('plain', 'moved'))
    growth = np.linalg.norm(moved, axis=1) - np.linalg.norm(plain, axis=1)
    np.testing.assert_allclose(growth, 1e-4, atol=1e-9)
    wrong = ['--effects', str(tmp_path / 'wrong.yaml'), '--out', str(tmp_path / 'none')]
    assert cli.main([*common, *wrong]) == 2
    assert not (tmp_path / 'none').exists()


# ---------------------------------------------------------------- found again

INVISIBLE = ('table_tilt', 'target_offset', 'tracker_scale')
"""Leave no trace in one run from one place: as docs/effects.md says of each."""
SHORT_PIECES = {'cyclic_error': 1e-3, 'vibration': 1e-3, 'table_resolution': 2e-3}
"""m; path pieces short against what they are to show, others as by default."""
TYPICAL = {'m': 1e-6, 'rad': 1e-6, 's': 1e-5, 'm/m': 1e-6, 'rad/m': 1e-6}
"""Sizes of coefficients that count as visible if they are determined to this."""


def information(name, machine, plan, samples):
    """What the data say of the coefficients once tables and pose are fitted jointly.

    Returns the matrix S and the vector b of S c = b, and the terms.
    """
    config = CalibrationConfig(piece_length=SHORT_PIECES.get(name, 8e-3))
    runs, nodes = prepare_runs([Recording(samples, plan.path, machine)], config)
    unknowns = layout(linear_bases(machine, nodes))
    done = solve_jointly(runs, unknowns, config, lambda stage, fraction: None)
    run, pose, system = runs[0], done.runs[0].pose, done.runs[0].system
    tables = tables_of(machine, unknowns, done.solution)
    state = state_on_path(
        machine, plan.path.corners()[0], run.pieces.leg, system.q, run.pieces.speed,
        run.pieces.time, pose, nodes, tables, samples.time[-1],
    )  # fmt: skip
    shape = shape_of(name) | ({'order': 2.0} if 'tau' in EXAMPLES[name] else {})
    terms = REGISTRY[name].terms(state, shape)
    extra = np.einsum('kij,ijc->kic', system.axes, terms.columns)
    whitener = Whitener.of(system, run.pieces, run.noise)
    group = np.zeros(len(whitener.bounds), dtype=int)
    normal = sum_groups(system, unknowns, whitener, group, extra)[0]
    matrix, f = normal.matrix, unknowns.free
    blocks = [unknowns.free_blocks[n] for n in done.solution.accepted]
    use = np.concatenate([np.arange(b.start, b.stop) for b in blocks])
    ridge = TIE_BREAK * smoothness(unknowns) / config.unidentifiable_above**2
    base = (matrix[:f, :f] + ridge)[np.ix_(use, use)]
    follow = np.linalg.solve(base, matrix[use, f:])
    left = matrix[f:, f:] - matrix[use, f:].T @ follow
    return 0.5 * (left + left.T), normal.right[f:] - follow.T @ normal.right[use], terms


@displacing
def test_effect_is_found_again_in_a_noisy_run(name, machine, plan):
    samples = simulate(machine, plan, CONFIG, effects=[applied(name)]).samples
    matrix, right, terms = information(name, machine, plan, samples)
    true = coefficients_of(name, terms)
    power = float(true @ matrix @ true)
    if name in INVISIBLE:
        assert power < 1.0, 'no uncertainty below the effect itself'
        return
    share, u_share = float(true @ right) / power, power**-0.5
    assert u_share < 0.3, 'the example is to be visible'
    assert abs(share - 1.0) < 3.0 * u_share
    size = np.array([TYPICAL.get(unit, 1e-5) for unit in terms.units])
    strength, basis = np.linalg.eigh(matrix * np.outer(size, size))
    seen = strength > 1.0
    estimate = basis[:, seen].T @ (right * size) / strength[seen]
    deviation = (estimate - basis[:, seen].T @ (true / size)) * np.sqrt(strength[seen])
    assert np.sqrt(np.mean(deviation**2)) < 1.0 + 3.0 / np.sqrt(2.0 * seen.sum())

# SPDX-License-Identifier: Apache-2.0
"""Blind trial: what is drawn."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from otf_core.blind import forms
from otf_core.blind.axis_cases import KINDS_OF, OF_LINEAR, draw_fault
from otf_core.blind.axis_nature import Errors
from otf_core.blind.axis_observer import AxisObserver
from otf_core.blind.axis_run import MACHINES, draw_axis_cell
from otf_core.blind.cases import KINDS, TAKE_TURNS, TILTS, draw_names, kinds_of, names_of
from otf_core.blind.depends import FAULTS, WITHOUT, kin_of
from otf_core.blind.draw import draw_effect, draw_trial, nodal, scale_effect
from otf_core.blind.forms import SENSOR, since_reversal
from otf_core.blind.natures import DEPARTED, FOLLOWING, OUTSIDE, UNKNOWN_EFFECTS
from otf_core.blind.observer import make_ruler, sample_state, see
from otf_core.blind.outcome import NOISE
from otf_core.blind.seal import orders
from otf_core.diagnosis.engine.time_courses import DECOYS
from otf_core.effects import EVERY, REGISTRY, AppliedEffect
from otf_core.model.joints import Sight
from otf_core.model.kinematics import exact_position
from otf_core.model.machine import machine_from_dict
from otf_core.model.plan import check_inside
from otf_core.sim.cell import simulate


@pytest.fixture(scope='module')
def trial():
    return draw_trial('000', np.random.default_rng(7), signals=True)


@pytest.fixture(scope='module')
def state(trial):
    return sample_state(trial, 0, trial.runs()[0])


@pytest.fixture(scope='module')
def ruler(trial):
    return make_ruler(trial)


def test_same_seed_draws_the_same_cell(trial):
    again = draw_trial('000', np.random.default_rng(7), signals=True)
    assert again.machine.to_dict() == trial.machine.to_dict()
    assert np.array_equal(again.plan.path.points, trial.plan.path.points)


@pytest.mark.parametrize('seed', range(4))
def test_drawn_paths_stay_inside_the_ranges(seed):
    drawn = draw_trial('000', np.random.default_rng(seed))
    check_inside(drawn.plan.path, drawn.machine)
    assert len(drawn.plan.feed) == len(drawn.plan.path.points) - 1


@pytest.mark.parametrize('seed', range(3))
def test_large_machines_are_driven_on_chords_inside_their_ranges(seed):
    drawn = draw_trial('000', np.random.default_rng(seed), large=True)
    check_inside(drawn.plan.path, drawn.machine)
    assert 2.0 <= (drawn.machine.upper - drawn.machine.lower)[0] <= 6.0
    assert drawn.configs[0].rate == 500.0 and drawn.plan.duration < 900.0


def test_causes_of_a_mixture_have_no_name_in_common():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        names = [names_of(n) for n in draw_names('mixture', seed, rng)]
        assert len(names) == 2 + seed % 2
        assert len(frozenset().union(*names)) == sum(map(len, names))


def test_kinds_come_in_their_shares():
    kinds = [k for k, _ in kinds_of(100, 3)]
    wanted = {k: round(100 * v.share) for k, v in KINDS.items()}
    assert {k: kinds.count(k) for k in KINDS} == wanted
    assert sum(wanted.values()) == 100


def test_leave_one_out_takes_an_effect_and_all_that_it_can_be():
    assert [o.names[0] for o in orders(len(WITHOUT), 1, leave_one_out=True)] == list(WITHOUT)
    assert set(kin_of('backlash')) >= {'backlash', 'direction_dependent_tables'}
    assert kin_of('vibration') == ('vibration',)
    assert all(name in kin_of(name) for name in REGISTRY)


@pytest.mark.parametrize('name', [n for n in (*OUTSIDE, *REGISTRY) if n not in NOISE])
def test_effects_are_drawn_and_scaled_in_proportion(name, trial, state):
    drawn = draw_effect(name, trial.machine, trial.plan.duration, np.random.default_rng(1))
    once = drawn.effect.displacement(state, drawn.parameters)
    twice = scale_effect(drawn, 2.0)
    assert np.abs(once).max() > 0
    assert np.allclose(twice.effect.displacement(state, twice.parameters), 2 * once)
    none = scale_effect(drawn, 0.0)
    assert not none.effect.displacement(state, none.parameters).any()


def test_forms_of_nature_are_not_in_the_registry():
    assert not set(OUTSIDE) & set(REGISTRY)
    assert not {type(e) for e in OUTSIDE.values()} & {type(e) for e in REGISTRY.values()}
    assert len(DEPARTED) >= 15
    assert all(e.stands_for <= set(REGISTRY) for e in OUTSIDE.values())
    assert {n for names in TAKE_TURNS.values() for n in names} == {*OUTSIDE, *REGISTRY}
    assert len(TILTS) == 3


def test_forms_share_no_code_with_catalogue_or_free_forms():
    tree = ast.parse(Path(forms.__file__).read_text(encoding='utf-8'))
    imports = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert {m for m in imports if m.startswith('otf_core.effects.')} == set()
    used = [n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)]
    assert used.count('more') == 1  # the sensor, not the history of free forms


def share_left(form, columns):
    """What least squares by columns (3n, k) leaves of a displacement."""
    rest = form - columns @ np.linalg.lstsq(columns, form, rcond=None)[0]
    return np.linalg.norm(rest) / np.linalg.norm(form)


def test_what_follows_a_signal_is_late_and_in_proportion(state):
    warm = FOLLOWING['departed_warm_head'].displacement(state, {'draw': 5.0, 'A': 1e-6})
    size, sensor = np.linalg.norm(warm, axis=1), state.more[SENSOR]
    assert np.allclose(np.cross(warm, warm[-1]), 0.0, atol=1e-20)  # one direction
    assert size[0] == 0.0 and np.argmax(size) > np.argmax(sensor > 0.9 * sensor.max())
    assert np.corrcoef(size, sensor)[0, 1] > 0.5


@pytest.mark.parametrize('name', DEPARTED)
def test_other_forms_depart_from_the_formula(name, trial, state):
    drawn = draw_effect(name, trial.machine, trial.plan.duration, np.random.default_rng(4))
    rows = np.linspace(0, len(state) - 1, 1500).astype(int)
    moved, at = drawn.effect.displacement(state, drawn.parameters)[rows].ravel(), state.part(rows)
    for known in drawn.effect.stands_for:
        effect = REGISTRY[known]
        probe = (
            [effect.complete_shape({effect.wave.parameter: effect.wave.probe})]
            if effect.wave
            else effect.shapes(state)
        )
        for shape in probe:
            columns = effect.terms(at, shape).columns
            assert share_left(moved, columns.reshape(-1, columns.shape[2])) > 0.02


def test_inputs_of_the_truth_are_those_that_it_changes_with(trial, state):
    rng = np.random.default_rng(6)
    senses = {'sense_x', 'sense_y', 'sense_z'}
    for name, effect in UNKNOWN_EFFECTS.items():
        drawn = draw_effect(name, trial.machine, trial.plan.duration, rng)
        depends = effect.depends_on(state, drawn.parameters)
        names = {n for group in depends.groups for n in group}
        moved = effect.displacement(state, drawn.parameters)
        if names and names <= senses:  # constant wherever these senses are
            axes = ['xyz'.index(n[-1]) for n in sorted(names)]
            sense = np.sign(np.where(np.abs(state.direction) > 1e-9, state.direction, 0))[:, axes]
            use = state.speed > 0
            if 'time' not in depends.besides:
                for value in np.unique(sense[use], axis=0):
                    own = moved[use][np.all(sense[use] == value, axis=1)]
                    assert np.ptp(own, axis=0).max() < 1e-12
        if names == {'time'} and 'tracker' not in name:
            assert np.abs(np.diff(moved, axis=0)).max(axis=1).nonzero()[0].size


def left_by(decoys, state, moved, values):
    """Least share of a displacement that a decoy leaves, its shape being one of the values."""
    shares = []
    for decoy in decoys:
        for value in values:
            columns = decoy.terms(state, {decoy.shape_names[0]: value}).columns
            flat = columns.reshape(-1, columns.shape[2])
            rest = moved - flat @ np.linalg.lstsq(flat, moved, rcond=None)[0]
            shares.append(np.linalg.norm(rest) / np.linalg.norm(moved))
    return min(shares)


@pytest.mark.parametrize('name', UNKNOWN_EFFECTS)
def test_unknown_effects_say_whether_a_decoy_has_their_formula(name, trial, state):
    drawn = draw_effect(name, trial.machine, trial.plan.duration, np.random.default_rng(2))
    rows = np.linspace(0, len(state) - 1, 1500).astype(int)
    moved = drawn.effect.displacement(state, drawn.parameters)[rows].ravel()
    at = state.part(rows)
    shapes = [v for k, v in drawn.parameters.items() if k in drawn.effect.shape_names]
    exactly = left_by(DECOYS, at, moved, shapes) < 1e-9 if shapes else False
    assert exactly == drawn.effect.has_decoy
    if not exactly:  # no shape that the diagnosis tries comes near either
        tried = [left_by([d], at, moved, [next(iter(s.values())) for s in d.shapes(state)])
                 for d in DECOYS]  # fmt: skip
        assert min(tried) > 0.3


def test_ringing_starts_anew_at_every_start(state):
    moved = DEPARTED['departed_ringing'].displacement(state, {'draw': 3.0, 'A': 1e-6})
    starts = np.flatnonzero(np.diff((state.speed > 0).astype(int)) == 1) + 1
    legs = [np.linalg.norm(moved[s : s + 60], axis=1) for s in starts]
    assert np.allclose([leg[0] for leg in legs], 0.0, atol=1e-12)
    assert np.allclose(legs, legs[0], atol=2e-9)
    assert legs[0].max() > 0.5e-6


def test_tables_and_poses_that_can_follow_leave_nothing(trial, ruler):
    other = trial.tables.scaled(1.1)
    moved = [exact_position(other, s.q) - exact_position(trial.tables, s.q) for s in ruler.states]
    assert ruler.raw(moved) > 1e-6
    assert ruler.size(moved) < 1e-3 * ruler.raw(moved)
    turned = [np.array([1e-6, 0, 2e-6]) + 1e-6 * s.beam[:, [2, 0, 1]] * [1, 0, 0]
              - 1e-6 * s.beam[:, [0, 1, 0]] * [0, 0, 1] for s in ruler.states]  # fmt: skip
    assert ruler.size(turned) < 1e-3 * ruler.raw(turned)


def test_of_what_jumps_from_piece_to_piece_only_the_degrees_of_freedom_are_lost(ruler):
    rng, moved = np.random.default_rng(8), []
    for sight in ruler.observer.sights:
        jumps = np.zeros_like(sight.state.q)
        jumps[sight.use] = 1e-6 * rng.standard_normal((len(sight.first), 3))[sight.piece]
        moved.append(jumps)
    rows, unknowns = ruler.observer.columns.shape
    assert ruler.size(moved) == pytest.approx(1e-6 * np.sqrt(2 * (1 - unknowns / rows)), rel=0.03)


def test_noise_of_the_simulated_tracker_is_freed_to_unit_variance(trial, ruler):
    other = [replace(c, seed=c.seed + 1) for c in trial.configs]
    runs = [simulate(trial.machine, trial.plan, c, trial.tables) for c in other]
    for sight, run, first in zip(ruler.observer.sights, runs, ruler.runs, strict=True):
        points = run.samples.xyz @ run.rotation + run.place
        assert not np.allclose(run.place, first.place)
        noise = points - exact_position(trial.tables, sight.state.q)
        turned = replace(sight.state, beam=sight.state.q - run.place)
        white = see(turned, sight.config)
        values = white.white_samples(white.seen(noise))
        assert np.mean(values**2) == pytest.approx(1.0, abs=0.03)
        means = white.white_pieces(white.mean(white.seen(noise))[:, :, None])
        assert np.mean(means**2) == pytest.approx(1.0, abs=0.05)
        assert abs(np.mean(means[1:] * means[:-1])) < 0.05


def test_travel_since_reversal_is_remembered_across_a_stop():
    q = np.array([0.0, 1.0, 2.0, 2.0, 3.0, 2.0, 1.5])
    sign, travel = since_reversal(q)
    assert sign.tolist() == [1, 1, 1, 1, 1, -1, -1]
    assert travel[[4, 6]] == pytest.approx([3.0, 0.5])


def test_nodal_tables_agree_at_the_nodes(trial):
    straight = nodal(trial.tables)
    for name, table in straight.motions.items():
        assert np.allclose(trial.tables.motions[name].at(table.position), table.value)


def test_step_is_zero_before_its_moment(state):
    step = AppliedEffect(UNKNOWN_EFFECTS['unknown_machine_step'], {'t0': 100.0, 'A_X': 1e-6})
    moved = step.effect.displacement(state, step.parameters)
    assert not moved[state.time < 100.0].any()
    assert np.all(moved[state.time > 100.0, 0] == 1e-6)


# Machines with rotary axes: a nature of their own.


@pytest.fixture(scope='module')
def cell():
    return draw_axis_cell('rotary', np.random.default_rng(5))


@pytest.fixture(scope='module')
def axis_observer(cell):
    return AxisObserver.of(cell)


@pytest.mark.parametrize('kind', MACHINES)
def test_nature_with_rotary_axes_is_driven_in_range_and_is_the_machine_that_it_states(kind):
    drawn = draw_axis_cell(kind, np.random.default_rng(3))
    machine = machine_from_dict(drawn.machine.spec)
    for part, driven in zip(drawn.parts, drawn.driven, strict=True):
        assert np.all(part.corners >= machine.lower - 1e-9)
        assert np.all(part.corners <= machine.upper + 1e-9)
        link, place = drawn.machine.target(part.target)
        q = driven.q[::500]
        sight = Sight(machine, machine.tracker.link, link, place)
        own = drawn.machine.place(q, Errors(), link, place)
        assert np.allclose(own, sight.nominal(q), atol=1e-9)
        known = next(n for n in drawn.errors.constants if n.endswith('C'))
        moved = drawn.machine.place(q, Errors({}, {known: 1e-4}), link, place) - own
        turns = np.ptp(q[:, drawn.machine.column('C')]) > 0.0
        assert moved.any() == (turns and 'C' in {j.name for j in sight.joints})


@pytest.mark.parametrize('kind', MACHINES)
def test_faults_of_rotary_axes_displace_in_proportion(kind):
    drawn = draw_axis_cell(kind, np.random.default_rng(2))
    rng = np.random.default_rng(1)

    part = replace(drawn.driven[2], clock=drawn.driven[2].clock[::10], again=True)

    def moved(*faults):
        return drawn.machine.seen(part, drawn.errors, drawn.places, drawn.tracker, faults)

    for name in KINDS_OF[kind]:
        fault = draw_fault(name, drawn.machine, rng, ''.join(drawn.machine.turning))
        once, twice = (moved(fault.scaled(f)) - moved() for f in (1.0, 2.0))
        assert 1e-7 < np.abs(once).max() < 1e-4, name
        assert np.linalg.norm(twice - 2 * once) < 0.05 * np.linalg.norm(once), name
    assert set(FAULTS.values()) <= set(EVERY) and set(OF_LINEAR) < set(FAULTS)


def test_observer_of_rotary_axes_follows_other_errors_and_knows_the_noise(cell, axis_observer):
    constants = {n: v + 1e-5 for n, v in cell.errors.constants.items()}
    raised = Errors({n: (lambda q, f=f: f(q) + 1e-5) for n, f in cell.errors.motions.items()},
                    constants)  # fmt: skip
    moves = [cell.machine.seen(p, raised, cell.places, cell.tracker) - plain
             for p, plain in zip(cell.driven, axis_observer.plain, strict=True)]  # fmt: skip
    assert np.abs(moves[0]).max() > 1e-5
    assert axis_observer.left(moves)[0] < 3e-8
    points = cell.measured(axis_observer.plain).xyz @ cell.rotation.T + cell.tracker
    cuts = np.cumsum([len(p) for p in axis_observer.plain])[:-1]
    noise = [a - b for a, b in zip(np.split(points, cuts), axis_observer.plain, strict=True)]
    rows, unknowns = axis_observer.columns.shape
    assert axis_observer.left(noise)[1] ** 2 == pytest.approx(rows - unknowns, rel=0.1)

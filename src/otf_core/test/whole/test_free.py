# SPDX-License-Identifier: Apache-2.0
"""Free forms: what they compute, how files keep them, when they are named beside a formula."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from core_cells import some_machine
from effect_cells import driven_state
from engine_cells import holding, noise, solved_rows

from otf_core.diagnosis.engine.effect_products import tried_shapes
from otf_core.diagnosis.engine.empirical_structure import (
    find_another,
    find_structure,
    try_structures,
)
from otf_core.diagnosis.engine.search import search, tried_effects
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.action import (
    Along,
    rigid_tracker,
    turned_about_zero_by_axis,
    turned_by_axis,
    vector,
)
from otf_core.effects.effects_yaml import effects_from_data, effects_to_data
from otf_core.effects.free import Free
from otf_core.effects.free_form import FreeForm, free_forms, node_table, of_table
from otf_core.effects.inputs import (
    DIRECTION,
    MOMENT,
    PLACE,
    cycle_period,
    head_of,
    numbers_of,
    scaled_input,
    unscaled_input,
)
from otf_core.effects.removable_effect import removable_effect
from otf_core.effects.state import lap_numbers, path_history, travel_at_start
from otf_core.errors import ConfigError
from otf_core.tracking.curves import Lines, straight_shape

EVERY = [(name, k) for name, e in REGISTRY.items() for k in range(len(e.free))]
every_form = pytest.mark.parametrize(('name', 'number'), EVERY)


@pytest.fixture(scope='module')
def state():
    return driven_state()


def form_of(name, number, state):
    effect = REGISTRY[name]
    return FreeForm.bound(effect, effect.free[number], [state])


def parameters_of(form, state, seed=1):
    """Small random coefficients, and the first shape."""
    wave = form.wave
    shape = form.complete_shape({wave.parameter: wave.probe} if wave else form.shapes(state)[0])
    names = form.terms(state.part(slice(0, 1)), shape).names
    values = 1e-6 * np.random.default_rng(seed).standard_normal(len(names))
    return {**shape, **dict(zip(names, values.tolist(), strict=True))}


# ---------------------------------------------------------------- what they compute


@every_form
def test_form_says_what_departs_and_how_smooth_each_term_is(name, number, state):
    form = form_of(name, number, state)
    terms = form.terms(state, form.complete_shape(parameters_of(form, state)))
    assert form.name == name and len(form.form.words) > 10
    assert len(terms.orders) == len(terms.names) == terms.columns.shape[2]
    assert min(terms.orders) == 0.0
    assert max(terms.orders) == sum(form.form.orders) - sum(form.form.least)
    assert np.all(np.isfinite(terms.columns))
    assert list(form.orders_of(terms.names)) == list(terms.orders)


@every_form
def test_file_keeps_a_free_form_to_the_last_digit(name, number, state):
    form, machine = form_of(name, number, state), some_machine('w-Y-b-X-Z-t')
    given = AppliedEffect(form, parameters_of(form, state))
    text = yaml.safe_dump(effects_to_data([given], machine))
    (again,) = effects_from_data(yaml.safe_load(text), 'file', machine)
    assert again == given
    assert np.array_equal(
        again.effect.displacement(state, again.parameters),
        form.displacement(state, given.parameters),
    )


def test_play_that_changes_with_time_is_the_formula_times_a_polynomial(state):
    form = form_of('backlash', 0, state)
    moved = form.displacement(state, {'held': 1.0, 'B_Y_0': 4e-6, 'B_Y_2': 2e-6})
    u = 2 * state.time / state.end - 1
    wanted = 0.5 * state.side[:, 1] * (4e-6 + 2e-6 * 0.5 * (3 * u**2 - 1))
    assert np.allclose(moved[:, 1], wanted, atol=1e-12)
    assert not np.any(moved[:, [0, 2]])


def test_rounding_vanishes_far_from_corners(state):
    form = form_of('corner_rounding', 0, state)
    far = replace(state, to_corner=np.full(len(state), 1e9))
    assert np.allclose(form.displacement(far, {'to_3': 1e-5}), 0.0, atol=1e-9)


def test_travel_since_a_reversal_is_carried_across_corners():
    unit = np.array([[1.0, 0, 0], [0, 1, 0], [0.6, 0.8, 0], [-1, 0, 0]])
    length = np.array([0.3, 0.2, 0.1, 0.3])
    found = travel_at_start(unit, length)
    assert np.allclose(found[:, 0], [0.0, 0.3, 0.3, 0.0])
    assert np.allclose(found[:, 1], [0.0, 0.0, 0.2, 0.28])


def test_laps_are_counted_in_either_sense():
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 0, 0], [0, 0, 0], [1, 0, 0.0]])
    assert lap_numbers(corners).tolist() == [0, 0, 1, 1, 2]


def test_acceleration_is_known_up_to_both_ends_of_every_leg():
    """Two legs of 0.2 m: 2 m/s^2 up to 0.2 m/s, and down again."""
    moment = np.linspace(0.01, 1.09, 109)
    speed = np.minimum(0.2, 2.0 * np.minimum(moment, 1.1 - moment))
    along = np.interp(moment, moment, np.cumsum(speed) * 0.01)
    leg = np.repeat([0, 1], len(moment))
    q = np.zeros((len(leg), 3))
    q[:, 0] = np.concatenate([along, 0.2 - along])
    corners = np.array([[0.0, 0, 0], [0.2, 0, 0], [0.0, 0, 0]])
    lines = Lines.of(straight_shape(corners))
    time = np.concatenate([moment, 2.0 + moment])
    found = path_history(lines, leg, q, np.tile(speed, 2), time)['acceleration']
    for one in np.split(found, 2):
        assert one[0] == pytest.approx(2.0) and one[-1] == pytest.approx(-2.0)
        assert np.allclose(one[20:-20], 0.0, atol=1e-9)


@pytest.mark.parametrize('name', ['time', 'x', 'since_stop', 'from_corner', 'azimuth'])
def test_scaling_turns_back(name):
    span = (0.0, 2.0)
    values = np.linspace(0.0, 2.0, 9)
    place = scaled_input(name, values, span)
    assert np.all(np.abs(place) <= 1.0) and np.all(np.diff(place) > 0)
    assert np.allclose(unscaled_input(name, place, span), values, atol=1e-9)


# ---------------------------------------------------------------- empirical effects


def test_table_is_met_at_its_nodes_and_kept_by_the_file(state):
    machine = state.machine
    nodes = {'time': [0.0, 40.0, 100.0], 'x': [0.0, 0.1, 0.3, 0.5]}
    values = {'Z': 1e-6 * np.arange(12.0).reshape(3, 4) ** 1.5}
    one = of_table('sinking', vector, nodes, values)
    probe = state.part(slice(0, 12))
    t, x = np.meshgrid(nodes['time'], nodes['x'], indexing='ij')
    q = np.zeros((12, 3))
    q[:, 0] = x.ravel()
    at = replace(probe, time=t.ravel(), q=q)
    moved = one.effect.displacement(at, one.parameters)
    assert np.allclose(moved[:, 2], values['Z'].ravel(), atol=1e-15)
    assert not np.any(moved[:, :2])
    (entry,) = effects_to_data([one], machine)
    assert entry['effect'] == 'empirical' and entry['name'] == 'sinking'
    (again,) = effects_from_data([yaml.safe_load(yaml.safe_dump(entry))], 'file', machine)
    again_moved = again.effect.displacement(state, again.parameters)
    assert np.allclose(again_moved, one.effect.displacement(state, one.parameters), atol=1e-14)


def test_table_of_a_free_function_says_the_same():
    form = Free(('time',), (6,), least=(1,), acts=rigid_tracker)
    effect = FreeForm(of_table('a', vector, {'time': [0, 1]}, {'X': [0, 0]}).effect.parent, form,
                      {'time': (0.0, 90.0)})  # fmt: skip
    one = AppliedEffect(effect, {'M_X_2': 1e-6, 'W_Z_5': 3e-6})
    nodes, values = node_table(one)
    at = np.array(nodes['time'])
    u = at / 45.0 - 1.0
    assert np.allclose(values['M_X'], 1e-6 * 0.5 * (3 * u**2 - 1), atol=1e-15)


@pytest.mark.parametrize(
    ('name', 'last'), [('since_stop', 3.0), ('near:0.1,0.2,-0.1', 0.4), ('from_corner', 0.1)]
)
def test_table_of_an_input_that_ends_early_can_be_read_again(name, last):
    form = Free((name,), (6,), acts=vector)
    effect = FreeForm(of_table('a', vector, {'time': [0, 1]}, {'X': [0, 0]}).effect.parent, form,
                      {name: (0.0, last)})  # fmt: skip
    given = {f'{a}_{k}': 1e-6 * (k - 2.5) for a in 'XYZ' for k in range(7)}
    nodes, values = node_table(AppliedEffect(effect, given))
    again = of_table('a', vector, nodes, values)
    assert nodes[name][-1] == pytest.approx(last)
    assert again.parameters == pytest.approx(given, rel=1e-6, abs=1e-12)


def test_file_that_asks_for_an_unknown_form_is_refused():
    entry = {'effect': 'backlash', 'form': 'free', 'inputs': {'range': [0, 1]}, 'parameters': {}}
    with pytest.raises(ConfigError, match='no free form of these inputs; possible: time;'):
        effects_from_data([entry], 'file', some_machine())


def test_rougher_coefficients_are_held_tighter_when_taken_off(state):
    form = form_of('backlash', 0, state)
    one = removable_effect([AppliedEffect(form, parameters_of(form, state))], 'found')
    precision = one.precision(np.ones(one.size))
    orders = form.orders_of(one.names)
    assert precision[orders == 3] == pytest.approx(16 * precision[orders == 0])


def test_table_over_a_cycle_repeats_and_is_met_at_its_nodes(state):
    nodes = {'cycle:20': [0.0, 4.0, 8.0, 12.0, 16.0]}
    values = 1e-6 * np.array([1.0, 4.0, -2.0, 0.5, 3.0])
    one = of_table('pump', vector, nodes, {'Y': values})
    at = replace(state.part(slice(0, 10)), time=np.arange(10) * 4.0)
    moved = one.effect.displacement(at, one.parameters)
    assert np.allclose(moved[:, 1], np.tile(values, 2), atol=1e-15)
    between = np.linspace(0.0, 20.0, 200)
    probe = driven_state()
    at = replace(probe.part(slice(0, 200)), time=between)
    curve = one.effect.displacement(at, one.parameters)[:, 1]
    spectrum = np.abs(np.fft.rfft(curve[:-1]))
    assert spectrum[3:].max() < 0.05 * spectrum.max()
    (entry,) = effects_to_data([one], state.machine)
    assert list(entry['nodes']) == ['cycle:20']
    assert np.allclose(entry['nodes']['cycle:20'], nodes['cycle:20'])
    assert np.allclose(entry['table']['Y'], values, atol=1e-15)


# ---------------------------------------------------------------- in a search


def found_of(displacement, names, seed=3, rows=None):
    """Causes that a search of some effects finds in noise and a displacement of the pieces."""
    rows = rows or solved_rows()
    parts = []
    for run, state in zip(rows.done.runs, rows.states, strict=True):
        parts.append(np.einsum('cpk,pk->cp', run.system.axes, displacement(state)).ravel())
    rows = holding(noise(seed) + np.concatenate(parts), rows)
    tried, _ = tried_effects(rows, [REGISTRY[n] for n in names], {})
    return search(rows, tried)[0]


def play(size):
    return lambda s: 0.5 * (size(s) * np.sign(np.round(s.direction[:, 0], 6)))[:, None] * [1, 0, 0]


def test_formula_is_named_where_it_is_as_good():
    causes = found_of(play(lambda s: np.full(len(s.time), 6e-6)), ['backlash', 'cross_coupling'])
    assert [c.option.effect for c in causes] == [REGISTRY['backlash']]


def test_free_form_is_named_where_play_departs_from_the_formula():
    warm = play(lambda s: 6e-6 * (1.5 - 1.2 * (s.time / s.end - 0.3) ** 2))
    (cause,) = found_of(warm, ['backlash', 'servo_mismatch', 'cross_coupling'])
    assert cause.option.effect.name == 'backlash'
    assert list(cause.option.effect.spans) == ['time']
    assert set(cause.option.axes) == {'X'}


def test_free_forms_name_nothing_in_noise():
    names = ['backlash', 'servo_mismatch', 'table_tilt', 'corner_rounding']
    for seed in (21, 22):
        assert found_of(lambda s: np.zeros((len(s), 3)), names, seed) == []


@pytest.mark.parametrize('course', [lambda u: u, lambda u: u + np.hypot(u, 0.03)])
def test_tilt_about_a_fixed_point_is_named_where_the_tracker_stood_at_two_places(course):
    def tilting(s):
        return course(s.q[:, :1] - 0.1) * np.cross([6e-4, -4e-4, 2e-4], s.q - [0.1, 0.2, -0.6])

    rows = solved_rows()
    first, second = rows.states
    moved = replace(second, beam=second.beam + np.array([0.9, -0.7, 0.2]))
    two = replace(rows, states=(first, moved))
    causes = found_of(tilting, ['table_tilt', 'cross_coupling', 'tracker_angles'], rows=two)
    assert causes[0].option.effect.name == 'table_tilt'
    assert causes[0].option.effect.form.acts is turned_about_zero_by_axis


def test_tilt_about_a_fixed_point_is_no_form_of_its_own_from_one_place():
    (first, _) = solved_rows().states
    forms = free_forms(REGISTRY['table_tilt'], [first, first])
    assert [form.form.acts for form in forms] == [turned_by_axis]


def gap_of(displacement, seed):
    """Noise and a displacement of the pieces."""
    rows = solved_rows()
    parts = [
        np.einsum('cpk,pk->cp', run.system.axes, displacement(state)).ravel()
        for run, state in zip(rows.done.runs, rows.states, strict=True)
    ]
    return holding(noise(seed) + np.concatenate(parts))


@pytest.mark.parametrize('number', [1, 2])
def test_a_shift_that_no_position_changes_is_no_expansion(number):
    def odds(displacement):
        form = form_of('thermal_axis_expansion', number, solved_rows().states[0])
        shape = form.complete_shape({'tau': 60.0}) if form.form.shaped else {}
        (tried,) = tried_shapes(gap_of(displacement, 21), form, [shape])
        return max(tried.odds(take, 1.0) for take in tried.takes)

    def shifting(s):
        return (9e-6 * (1.0 - np.exp(-s.time / 60.0)))[:, None] * [0.0, 0.0, 1.0]

    assert odds(shifting) < 9.0
    assert odds(lambda s: shifting(s) * (1.0 + s.q[:, 2:] / 0.1)) > 100.0


def test_structure_of_a_gap_without_a_name_is_found():
    def sinking(s):
        u = 2 * s.q[:, 0] / s.machine.upper[0] - 1
        return (8e-6 * (s.time / s.end) ** 2 * np.tanh(2 * u))[:, None] * [0, 0, 1]

    found = find_structure(try_structures(gap_of(sinking, 5)))
    assert set(found.effect.form.inputs) == {'time', 'x'}
    assert isinstance(found.effect.form.acts, Along)
    assert abs(found.effect.form.acts.direction[2]) > 0.98


def test_what_comes_and_goes_in_turn_is_found_with_its_period():
    period = max(s.end for s in solved_rows().states) / 11.3

    def pump(s):
        phase = np.mod(s.time, period) / period
        return (4e-6 * np.exp(-4.0 * phase))[:, None] * [0.6, 0.0, 0.8]

    (name,) = find_structure(try_structures(gap_of(pump, 8))).effect.form.inputs
    assert cycle_period(name) == pytest.approx(period, rel=2e-3)


def place_of(structure):
    """Head and numbers of the one input of a structure."""
    (name,) = structure.effect.form.inputs
    return head_of(name), np.array(numbers_of(name))


def test_a_jolt_is_found_with_its_moment_and_its_run():
    moment = 0.6 * solved_rows().states[1].end

    def jolt(s):
        hit = len(s) == len(solved_rows().states[1])
        return (5e-6 * hit * (s.time > moment))[:, None] * [0.0, 0.6, 0.8]

    found = find_structure(try_structures(gap_of(jolt, 11)))
    head, (at,) = place_of(found)
    assert head == MOMENT
    assert at == pytest.approx(moment, abs=1.0)
    assert found.effect.own_per_run


def test_a_place_that_is_off_is_found():
    machine = solved_rows().states[0].machine
    place = machine.lower + np.array([0.4, 0.55, 0.5]) * (machine.upper - machine.lower)

    def dent(s):
        distance = np.linalg.norm(s.q - place, axis=1)
        return (25e-6 / (1.0 + (distance / 0.05) ** 4))[:, None] * [0.7, 0.0, -0.7]

    head, at = place_of(find_structure(try_structures(gap_of(dent, 12))))
    assert head == PLACE
    assert np.linalg.norm(at - place) < 0.03


def test_a_direction_of_the_beam_that_is_off_is_found():
    beam = np.concatenate([s.beam for s in solved_rows().states])
    towards = beam.mean(axis=0)

    def plume(s):
        cosine = s.beam @ towards / np.linalg.norm(s.beam, axis=1) / np.linalg.norm(towards)
        return (12e-6 / (1.0 + (np.arccos(cosine) / 0.1) ** 4))[:, None] * [0.0, 0.5, 0.9]

    head, (azimuth, elevation) = place_of(find_structure(try_structures(gap_of(plume, 13))))
    found = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation),
             np.sin(elevation)]  # fmt: skip
    assert head == DIRECTION
    assert np.arccos(found @ towards / np.linalg.norm(towards)) < 0.1


def test_what_a_structure_leaves_may_follow_another_input():
    def clamps(s):
        stands = np.abs(s.direction) < 1e-6
        return stands * [6e-6, -8e-6, 5e-6]

    tried = try_structures(gap_of(clamps, 14))
    first = find_structure(tried)
    second = find_another(tried, [first])
    named = {n for f in (first, second) for n in f.effect.form.inputs}
    assert named == {'sense_x', 'sense_y', 'sense_z'}
    assert find_another(tried, [first, second]) is None


def test_what_switches_now_and_then_is_a_function_of_time():
    length = max(s.end for s in solved_rows().states)
    moments = length * np.array([0.11, 0.17, 0.34, 0.47, 0.52, 0.7, 0.93])

    def switched(s):
        on = np.searchsorted(moments, s.time) % 2
        return (6e-6 * on)[:, None] * [0.0, 1.0, 0.0]

    assert find_structure(try_structures(gap_of(switched, 9))).effect.form.inputs == ('time',)


def test_free_forms_are_bound_to_the_ranges_of_the_runs():
    states = solved_rows().states
    (form, *_) = free_forms(REGISTRY['thermal_structure_drift'], states)
    assert form.spans == {'time': (0.0, max(s.end for s in states))}

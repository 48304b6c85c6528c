# SPDX-License-Identifier: Apache-2.0
"""Blind trial: drawing, sealing, scoring."""

import json

import numpy as np
import pytest

from otf_core.blind.cases import KINDS, kinds_of
from otf_core.blind.draw import draw_trial, nodal
from otf_core.blind.draw_effects import draw_effect, scaled
from otf_core.blind.outcome import NOISE, outcome
from otf_core.blind.recovery import parameter_deviations
from otf_core.blind.score import calibration
from otf_core.blind.seal import KEY, SEAL, open_key, orders
from otf_core.blind.trace import sample_state
from otf_core.blind.unknown_effects import UNKNOWN_EFFECTS, since_reversal
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.errors import InputError
from otf_core.model.plan import check_inside


def part(effect, size_um=2.0, snr=50.0, raw_um=4.0):
    return {'effect': effect, 'parameters': {}, 'size_um': size_um, 'raw_um': raw_um, 'snr': snr}


def entry(*parts, kind='one', bends_um=0.0):
    return {'cell': '000', 'kind': kind, 'parts': list(parts), 'bends_um': bends_um}


def answer(*causes, verdict='explained', not_visible=()):
    return {
        'verdict': verdict,
        'causes': [{'effect': e, 'indistinguishable_from': list(o), 'u': {}} for e, o in causes],
        'not_visible': [{'effect': n} for n in not_visible],
    }


@pytest.fixture(scope='module')
def trial():
    return draw_trial('000', np.random.default_rng(5))


@pytest.fixture(scope='module')
def state(trial):
    return sample_state(trial, 0, trial.runs()[0])


def test_same_seed_draws_the_same_cell(trial):
    again = draw_trial('000', np.random.default_rng(5))
    assert again.machine.to_dict() == trial.machine.to_dict()
    assert np.array_equal(again.plan.path.points, trial.plan.path.points)


@pytest.mark.parametrize('seed', range(12))
def test_drawn_paths_stay_inside_the_ranges(seed):
    drawn = draw_trial('000', np.random.default_rng(seed))
    check_inside(drawn.plan.path, drawn.machine)
    assert len(drawn.plan.feed) == len(drawn.plan.path.points) - 1


def test_kinds_come_in_their_shares():
    kinds = [k for k, _ in kinds_of(100, 3)]
    assert {k: kinds.count(k) for k in KINDS} == {k: round(100 * v) for k, v in KINDS.items()}


def test_leave_one_out_takes_every_effect_in_turn():
    assert [o.names[0] for o in orders(len(REGISTRY), 1, leave_one_out=True)] == list(REGISTRY)


@pytest.mark.parametrize('name', [n for n in (*UNKNOWN_EFFECTS, *REGISTRY) if n not in NOISE])
def test_effects_are_drawn_and_scaled_in_proportion(name, trial, state):
    drawn = draw_effect(name, trial.machine, trial.plan.duration, np.random.default_rng(1))
    once = drawn.effect.displacement(state, drawn.parameters)
    twice = scaled(drawn, 2.0)
    assert np.abs(once).max() > 0
    assert np.allclose(twice.effect.displacement(state, twice.parameters), 2 * once)
    none = scaled(drawn, 0.0)
    assert not none.effect.displacement(state, none.parameters).any()


def test_unknown_effects_are_not_in_the_registry():
    assert not set(UNKNOWN_EFFECTS) & set(REGISTRY)
    assert not {type(e) for e in UNKNOWN_EFFECTS.values()} & {type(e) for e in REGISTRY.values()}


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


@pytest.mark.parametrize(
    ('hidden', 'said', 'result'),
    [
        ([], answer(verdict='none'), 'quiet'),
        ([], answer(('tracker_noise', ())), 'quiet'),
        ([], answer(('backlash', ())), 'false_alarm'),
        ([], answer(verdict='unknown'), 'false_alarm'),
        ([part('backlash')], answer(('backlash', ())), 'right'),
        ([part('backlash')], answer(('tracker_noise', ()), ('backlash', ())), 'right'),
        ([part('backlash')], answer(('servo_mismatch', ('backlash',))), 'listed'),
        ([part('backlash')], answer(('servo_mismatch', ('backlash', *'abcd'))), 'wrong'),
        ([part('backlash')], answer(('vibration', ()), ('backlash', ())), 'second'),
        ([part('backlash')], answer(('vibration', ())), 'wrong'),
        ([part('backlash')], answer(verdict='unknown'), 'called_unknown'),
        ([part('backlash')], answer(verdict='none'), 'unseen'),
        ([part('table_tilt', 0.01, 1.0)], answer(not_visible=('table_tilt',)), 'not_visible'),
        ([part('table_tilt', 0.01, 1.0)], answer(verdict='none'), 'silent'),
        ([part('table_tilt', 0.01, 1.0)], answer(('backlash', ())), 'wrong'),
        ([part('unknown_machine_step')], answer(verdict='unknown'), 'unknown'),
        ([part('unknown_machine_step')], answer(('backlash', ())), 'forced'),
        ([part('backlash'), part('vibration')], answer(('vibration', ())), 'half'),
    ],
)
def test_outcomes(hidden, said, result):
    assert outcome(entry(*hidden), said).result == result


def test_effect_taken_out_of_the_catalogue_must_not_be_blamed_on_another():
    hidden = entry(part('backlash'))
    assert outcome(hidden, answer(('servo_mismatch', ())), ('backlash',)).result == 'forced'
    assert outcome(hidden, answer(verdict='unknown'), ('backlash',)).result == 'unknown'


def test_bends_of_smooth_tables_may_be_named():
    smooth = entry(bends_um=0.5)
    assert outcome(smooth, answer(('table_resolution', ()))).result == 'quiet'


def test_parameters_are_compared_where_shapes_agree():
    true = {'effect': 'cyclic_error', 'parameters': {'period': 0.01, 'S_X': 2e-6}}
    cause = {'effect': 'cyclic_error', 'parameters': {'period': 0.0101, 'S_X': 2.2e-6}}
    cause['u'] = {'S_X': 1e-7}
    assert parameter_deviations([true], [cause]) == pytest.approx((2.0,))
    cause['parameters']['period'] = 0.02
    assert parameter_deviations([true], [cause]) == ()


def test_changed_key_is_refused(tmp_path):
    (tmp_path / KEY).write_text(json.dumps({'cells': []}))
    (tmp_path / SEAL).write_text('0\n')
    with pytest.raises(InputError, match='sealed'):
        open_key(tmp_path)


def test_stated_confidence_is_compared_with_what_is_there():
    named = [('backlash', 0.995), ('servo_mismatch', 0.95), ('cross_coupling', 0.999)]
    given = {
        'verdict': 'explained',
        'not_visible': [],
        'causes': [{'effect': e, 'confidence': c, 'indistinguishable_from': []} for e, c in named],
    }
    scored = outcome(entry(part('backlash'), part('servo_mismatch'), kind='two'), given)
    assert scored.confidence == (0.995, 0.95, 0.999)
    lines = calibration([scored])
    assert [line.split('  ')[-1].strip() for line in lines] == ['1 of 1 (100 %)', '1 of 2 (50 %)']

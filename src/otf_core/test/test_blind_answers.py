# SPDX-License-Identifier: Apache-2.0
"""Blind trial: what answers count for, sealing, published tables."""

import json
from dataclasses import replace

import pytest

from otf_core.blind.cases import KINDS
from otf_core.blind.natures import OUTSIDE
from otf_core.blind.outcome import outcome
from otf_core.blind.publish import TrialConditions, criteria, fragment
from otf_core.blind.recovery import parameter_deviations
from otf_core.blind.score import (
    binomial_interval,
    expected_calibration_error,
    further_counts,
    leave_one_out,
    reliability,
    sizes,
    stated_confidences,
    summary,
)
from otf_core.blind.seal import KEY, SEAL, open_key
from otf_core.errors import InputError


def part(effect, size_um=2.0, snr=50.0, raw_um=4.0, groups=(), besides=()):
    names = sorted(OUTSIDE[effect].stands_for) if effect in OUTSIDE else [effect]
    return {
        'effect': effect,
        'names': names,
        'depends': {'groups': groups, 'besides': besides},
        'parameters': {},
        'size_um': size_um,
        'raw_um': raw_um,
        'snr': snr,
    }


def entry(*parts, kind='one', bends_um=0.0, heavy_tails=False):
    return {
        'cell': '000',
        'kind': kind,
        'parts': list(parts),
        'bends_um': bends_um,
        'heavy_tails': heavy_tails,
    }


def answer(*causes, verdict='explained', not_visible=()):
    return {
        'verdict': verdict,
        'causes': [{'effect': e, 'indistinguishable_from': list(o), 'u': {}} for e, o in causes],
        'not_visible': [{'effect': n} for n in not_visible],
    }


@pytest.mark.parametrize(
    ('hidden', 'said', 'result'),
    [
        ([], answer(verdict='none'), 'quiet'),
        ([], answer(('tracker_noise', ())), 'false_alarm'),
        ([], answer(('backlash', ())), 'false_alarm'),
        ([], answer(verdict='unknown'), 'false_alarm'),
        ([part('backlash')], answer(('backlash', ())), 'right'),
        ([part('backlash')], answer(('backlash', ()), ('tracker_noise', ())), 'right'),
        ([part('backlash')], answer(('tracker_noise', ()), ('backlash', ())), 'second'),
        ([part('backlash')], answer(('tracker_noise', ())), 'wrong'),
        ([part('tracker_noise')], answer(('tracker_noise', ())), 'right'),
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
        ([part('unknown_machine_step')], answer(('tracker_noise', ())), 'forced'),
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


def test_noise_that_is_not_there_is_a_needless_cause_and_counts_over_all_cells():
    said = answer(('backlash', ()), ('tracker_noise', ()))
    false = outcome(entry(part('backlash')), said)
    heavy = outcome(entry(part('backlash'), heavy_tails=True), said)
    there = outcome(entry(part('backlash'), part('tracker_noise'), kind='mixture'), said)
    assert [o.extra for o in (false, heavy, there)] == [('tracker_noise',), (), ()]
    row = next(
        r for r in further_counts([false, heavy, there]) if r.name.startswith('noise as spec')
    )
    assert (row.hits, row.of) == (1, 1)


def test_causes_of_no_catalogue_are_counted_where_they_leave_a_trace():
    said = [answer(verdict='unknown'), answer(('backlash', ())), answer(verdict='none')]
    cells = [outcome(entry(part('unknown_axis_brake'), kind='unknown'), a) for a in said]
    cells.append(outcome(entry(part('unknown_stick_slip', 0.0, 0.0), kind='unknown'), said[1]))
    rows = {r.name: r for r in (*summary(cells), *further_counts(cells))}
    assert rows['no catalogue: called unknown'][1:] == (1, 3)
    assert rows['no catalogue: given a name'][1:] == (1, 3)


def sure(*causes):
    said = answer(*((effect, ()) for effect, _ in causes))
    for cause, (_, confidence) in zip(said['causes'], causes, strict=True):
        cause['confidence'] = confidence
    return said


def test_a_cause_amid_small_ones_is_judged_by_itself_and_by_what_is_claimed_besides():
    hidden = entry(part('backlash'), part('vibration', 0.3), kind='as_is')
    cells = [
        outcome(hidden, sure(('backlash', 1.0), ('servo_mismatch', 0.95))),
        outcome(hidden, sure(('backlash', 1.0), ('servo_mismatch', 0.5), ('cyclic_error', 0.6))),
        outcome(hidden, sure(('vibration', 1.0))),
    ]
    assert [o.result for o in cells] == ['right', 'right', 'wrong']
    rows = {r.name: r.hits for r in summary(cells) if r.of == 3}
    assert rows['one cause amid small ones: named first'] == 2
    assert rows[', none claimed'] == 2


def test_small_causes_alone_are_right_unless_another_is_claimed():
    hidden = entry(part('backlash', 0.3), part('vibration', 0.2), kind='small')
    said = [answer(verdict='none'), sure(('servo_mismatch', 0.5)), sure(('backlash', 1.0))]
    assert {outcome(hidden, a).result for a in said} == {'quiet'}
    assert outcome(hidden, sure(('servo_mismatch', 0.95))).result == 'false_alarm'


def test_published_tables_are_the_rows_of_the_score(tmp_path):
    cells = [outcome(entry(), answer(verdict='none')) for _ in range(3)]
    cells = [replace(c, kind='none') for c in cells]
    (tmp_path / SEAL).write_text('0123456789abcdef0123\n')
    (tmp_path / '.fleet').mkdir()
    ended = {'exit': 0, 'message': '', 'sha256': 'f' * 64, 'seconds': 12.3}
    state = json.dumps({'inputs': '', 'outcome': ended})
    (tmp_path / '.fleet' / 'answers-000.json').write_text(state)
    measured = TrialConditions.of(tmp_path, [{'seed': 7}] * 3, '2026-01-01')
    text = fragment(measured, criteria(cells), 'Sizes: none.')
    assert './otf blind --trials 3 --seed 7 --out blind\n' in text
    assert '| nothing: no cause reported | 3 of 3 (100 %) | 29 % to 100 % |' in text
    assert '`0123456789abcdef...`' in text
    assert 'took 12 s' in text and text.endswith('Sizes: none.\n')
    rows = summary(
        [replace(c, kind=k, visible=(True,), found=(True,)) for k in KINDS for c in cells]
    )
    assert len(rows) + len(leave_one_out(cells, {})) <= 20


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
    scored = outcome(entry(part('backlash'), part('servo_mismatch'), kind='mixture'), given)
    assert scored.confidence == (0.995, 0.95, 0.999)
    classes = reliability(stated_confidences([scored]))
    assert [c.row.share for c in classes] == ['1 of 1 (100 %)', '1 of 2 (50 %)']
    assert [c.mean for c in classes] == pytest.approx([0.95, 0.997])
    off = (1 * 0.05 + 2 * 0.497) / 3
    assert expected_calibration_error(classes) == pytest.approx(off)


@pytest.mark.parametrize(
    ('hits', 'of', 'low', 'high'),
    # tables of the exact binomial: 1 - 0.025^(1/n) at the ends; 5 of 10 in Clopper and Pearson
    [(0, 10, 0.0, 0.3085), (10, 10, 0.6915, 1.0), (5, 10, 0.1871, 0.8129)],
)
def test_binomial_intervals_are_exact(hits, of, low, high):
    assert binomial_interval(hits, of) == pytest.approx((low, high), abs=1e-4)


def unnamed(*inputs, before=4.0, after=1.0):
    said = answer(verdict='unknown')
    found = {'depends_on': list(inputs), 'before_um': before, 'after_um': after}
    return {**said, 'unnamed': found if inputs else None}


@pytest.mark.parametrize(
    ('groups', 'besides', 'named', 'right', 'among'),
    [
        ([['time']], [], ['time'], True, True),
        ([['time']], [], ['time', 'x'], False, True),
        ([['time']], ['x'], ['time', 'x'], True, True),
        ([['time'], ['x']], [], ['time'], False, False),
        ([['feed', 'lap'], ['x']], [], ['lap', 'x'], True, True),
        ([['x'], ['y'], ['z']], [], ['x', 'z'], True, True),
        ([['x'], ['y'], ['z']], [], ['x'], False, False),
        ([['time']], [], [], False, False),
        ([], [], ['time'], None, None),
    ],
)
def test_inputs_are_right_if_they_are_those_of_the_truth(groups, besides, named, right, among):
    hidden = part('unknown_feed_offset', groups=groups, besides=besides)
    scored = outcome(entry(hidden, kind='unknown'), unnamed(*named))
    assert (scored.inputs_right, scored.inputs_among) == (right, among)


def test_a_cause_in_another_form_is_right_by_any_name_that_fits_it():
    worn = entry(part('departed_backlash_worn'), kind='departed')
    assert outcome(worn, answer(('direction_dependent_tables', ()))).result == 'right'
    assert outcome(worn, answer(('servo_mismatch', ('backlash',)))).result == 'listed'
    assert outcome(worn, answer(('servo_mismatch', ()))).result == 'wrong'
    assert outcome(worn, answer(verdict='unknown')).result == 'called_unknown'


def test_gap_left_is_that_of_the_cause_without_a_name_where_there_is_one():
    hidden = entry(part('unknown_feed_offset'), kind='unknown')
    said = {**unnamed('feed'), 'gap': {'before_um': 4.0, 'after_um': 4.0}}
    assert outcome(hidden, said).gap_left == pytest.approx(0.25)
    rows = {r.name: r for r in summary([outcome(hidden, said)])}
    assert rows[', less than half of the gap left'][1:] == (1, 1)


def test_a_cause_that_follows_a_signal_is_judged_by_the_signal_too():
    hidden = part('departed_warm_head', groups=[['signal:/spindle/temperature']])
    said = answer(('thermal_structure_drift', ()))
    assert outcome(entry(hidden, kind='signal'), said).follows is False
    curve = {'input': 'signal:/spindle/temperature@30', 'held': {}}
    said['causes'][0]['curves'] = [curve]
    scored = outcome(entry(hidden, kind='signal'), said)
    assert (scored.follows, scored.result) == (True, 'right')
    assert outcome(entry(part('backlash')), said).follows is None


def test_simulated_residual_is_compared_with_that_of_the_truth():
    said = {**answer(verdict='none'), 'gap': {'simulated_um': 1.1, 'simulated_u_um': 0.04}}
    scored = outcome({**entry(), 'simulated_um': 1.0}, said)
    assert scored.simulated_off == pytest.approx(2.5)
    rows = {r.name: r for r in sizes([], [scored])}
    assert rows['simulated residual within 2 u of the truth'][1:] == (0, 1)

# SPDX-License-Identifier: Apache-2.0
"""Blind trial: drawing, sealing, scoring."""

import ast
import json
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from otf_core.blind.cases import KINDS, TAKE_TURNS, kinds_of
from otf_core.blind.counts import binomial_interval, expected_calibration_error, reliability
from otf_core.blind.depends import WITHOUT, kin_of
from otf_core.blind.draw import draw_trial, nodal
from otf_core.blind.draw_effects import draw_effect, scaled
from otf_core.blind.natures import DEPARTED, OUTSIDE, UNKNOWN_EFFECTS
from otf_core.blind.outcome import NOISE, outcome
from otf_core.blind.publish import Measured, fragment
from otf_core.blind.recovery import parameter_deviations
from otf_core.blind.score import stated, summary
from otf_core.blind.seal import KEY, SEAL, open_key, orders
from otf_core.blind.sight import see
from otf_core.blind.table import criteria
from otf_core.blind.trace import make_ruler, sample_state
from otf_core.blind.view import since_reversal
from otf_core.diagnosis.engine.decoys import DECOYS
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.errors import InputError
from otf_core.model.kinematics import exact_position
from otf_core.model.plan import check_inside
from otf_core.sim.cell import simulate


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


@pytest.fixture(scope='module')
def trial():
    return draw_trial('000', np.random.default_rng(5))


@pytest.fixture(scope='module')
def state(trial):
    return sample_state(trial, 0, trial.runs()[0])


@pytest.fixture(scope='module')
def ruler(trial):
    return make_ruler(trial)


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
    wanted = {k: round(100 * v.share) for k, v in KINDS.items()}
    assert {k: kinds.count(k) for k in KINDS} == wanted
    assert sum(wanted.values()) == 100


def test_leave_one_out_takes_an_effect_and_all_that_it_can_be():
    assert [o.names[0] for o in orders(len(WITHOUT), 1, leave_one_out=True)] == list(WITHOUT)
    assert set(kin_of('backlash')) == {'backlash', 'direction_dependent_tables'}
    assert kin_of('vibration') == ('vibration',)
    assert all(name in kin_of(name) for name in REGISTRY)


@pytest.mark.parametrize('name', [n for n in (*OUTSIDE, *REGISTRY) if n not in NOISE])
def test_effects_are_drawn_and_scaled_in_proportion(name, trial, state):
    drawn = draw_effect(name, trial.machine, trial.plan.duration, np.random.default_rng(1))
    once = drawn.effect.displacement(state, drawn.parameters)
    twice = scaled(drawn, 2.0)
    assert np.abs(once).max() > 0
    assert np.allclose(twice.effect.displacement(state, twice.parameters), 2 * once)
    none = scaled(drawn, 0.0)
    assert not none.effect.displacement(state, none.parameters).any()


def test_forms_of_nature_are_not_in_the_registry():
    assert not set(OUTSIDE) & set(REGISTRY)
    assert not {type(e) for e in OUTSIDE.values()} & {type(e) for e in REGISTRY.values()}
    assert len(DEPARTED) >= 15
    assert all(e.stands_for <= set(REGISTRY) for e in OUTSIDE.values())
    assert {n for names in TAKE_TURNS.values() for n in names} == {*OUTSIDE, *REGISTRY}


FORBIDDEN = ('otf_core.effects.free', 'otf_core.effects.inputs', 'otf_core.effects.history')


@pytest.mark.parametrize('module', ['view', 'departed_forms', 'nameless_forms'])
def test_natures_share_no_code_with_catalogue_or_free_forms(module):
    tree = ast.parse(find_spec(f'otf_core.blind.{module}').loader.get_data(
        find_spec(f'otf_core.blind.{module}').origin).decode())  # fmt: skip
    imports = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert {m for m in imports if m.startswith('otf_core.effects.')} == set()
    used = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
    assert 'more' not in used  # the history that free forms use


def share_left(form, columns):
    """What least squares by columns (3n, k) leaves of a displacement."""
    rest = form - columns @ np.linalg.lstsq(columns, form, rcond=None)[0]
    return np.linalg.norm(rest) / np.linalg.norm(form)


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
    there = outcome(entry(part('backlash'), part('tracker_noise'), kind='two'), said)
    assert [o.extra for o in (false, heavy, there)] == [('tracker_noise',), (), ()]
    row = next(r for r in summary([false, heavy, there]) if r.name.startswith('noise as spec'))
    assert (row.hits, row.of) == (1, 1)


def test_unknown_effects_are_counted_apart_by_whether_a_decoy_exists():
    hidden = ['unknown_machine_step'] * 2 + ['unknown_axis_brake'] * 3
    said = [answer(verdict='unknown')] * 3 + [answer(('backlash', ())), answer(verdict='none')]
    cells = [outcome(entry(part(h), kind='unknown'), a) for h, a in zip(hidden, said, strict=True)]
    cells.append(outcome(entry(part('unknown_stick_slip', 0.0, 0.0), kind='unknown'), said[3]))
    rows = {r.name: r for r in summary(cells)}
    assert rows['no catalogue, a decoy exists: called unknown'][1:] == (2, 2)
    assert rows['no catalogue, no decoy: called unknown'][1:] == (1, 3)
    assert rows['no catalogue, no trace: given a name'][1:] == (1, 1)


def test_published_tables_are_the_rows_of_the_score(tmp_path):
    cells = [outcome(entry(), answer(verdict='none')) for _ in range(3)]
    cells = [replace(c, kind='none') for c in cells]
    (tmp_path / SEAL).write_text('0123456789abcdef0123\n')
    (tmp_path / '.fleet').mkdir()
    ended = {'exit': 0, 'message': '', 'sha256': 'f' * 64, 'seconds': 12.3}
    state = json.dumps({'inputs': '', 'outcome': ended})
    (tmp_path / '.fleet' / 'answers-000.json').write_text(state)
    measured = Measured.of(tmp_path, [{'seed': 7}] * 3, '2026-01-01', False)
    text = fragment(measured, criteria(cells, []))
    assert './otf blind --trials 3 --seed 7 --out blind\n' in text
    assert '| nothing: none blamed | 3 of 3 (100 %) | 29 % to 100 % |' in text
    assert '`0123456789abcdef...`' in text
    assert 'took 12 s' in text


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
    classes = reliability(stated([scored]))
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

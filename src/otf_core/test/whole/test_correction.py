# SPDX-License-Identifier: Apache-2.0
"""Effects taken off: the joint estimate, its uncertainty, what is refused."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import some_machine
from nature import Cell, Extra
from numpy.testing import assert_allclose

from otf_core.calibration.with_effects import correct_runs, estimates, missing_in_tables
from otf_core.config import CalibrationConfig
from otf_core.diagnosis import diagnose as above
from otf_core.diagnosis.corrected_calibration import (
    CausesToRemove,
    CauseWords,
    _to_take,
    pair_with_corrected,
)
from otf_core.diagnosis.diagnose import calibrate_with_effects
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.removable_effect import FILE, FOUND, removable_effect
from otf_core.effects.state import probe_state
from otf_core.errors import ConfigError
from otf_core.model.motions import MOTIONS
from otf_core.pieces.runs import prepare_runs
from otf_core.solving.joint import solve_jointly, tables_of
from otf_core.solving.reversal import Backlash, Reversal
from otf_core.solving.sensitivity import piece_state
from otf_core.solving.unknowns import free_values, layout, linear_bases

CONFIG = CalibrationConfig(piece_length=0.02)
GROWTH = {'tau': 100.0, 'until': 80.0, 'order': 2.0, 'S_X': 3e-5, 'S_Y': 1e-6, 'S_X_2': 0.0}


def one(name, how=FILE, **parameters):
    return removable_effect([AppliedEffect(REGISTRY[name], parameters)], how)


def small_cell(**extra):
    return Cell(
        seed=5,
        size=(0.3, 0.25, 0.2),
        pitch=0.15,
        form='polygon',
        path='short',
        passes=1,
        dwell=0.1,
        extra=Extra(**extra),
    )


@pytest.fixture(scope='module')
def runs_and_nodes():
    return prepare_runs([small_cell(growth=(20e-6, 0, 0)).recording(rate=20.0)], CONFIG)


def solved(runs, nodes, effects=()):
    if effects:
        runs = correct_runs(runs, effects, nodes, None)
    unknowns = layout(linear_bases(runs[0].machine, nodes), len(runs))
    return runs, solve_jointly(runs, unknowns, CONFIG, lambda stage, fraction: None)


def dense(runs, done, effect):
    """Whitened columns of the unknowns solved for and of the effect, and whitened deviations."""
    run, at = runs[0], done.runs[0]
    tables = tables_of(run.machine, done.unknowns, done.solution)
    state = piece_state(run, at, done.unknowns.knots, tables)
    extra = np.einsum('cij,ijk->cik', at.system.axes, effect.columns(state, 0))
    base = (at.system.design @ done.unknowns.gauge).toarray()
    white = [
        np.stack(
            [at.whitener.whiten(c.reshape(at.system.deviation.shape)).ravel() for c in m.T], 1
        )
        for m in (base, extra.reshape(-1, extra.shape[2]))
    ]
    return *white, at.whitener.whiten(at.system.deviation).ravel()


@pytest.mark.parametrize('how', [FILE, FOUND])
def test_estimate_is_the_joint_one_of_tables_poses_and_effects(runs_and_nodes, how):
    effect = one('thermal_axis_expansion', how, **GROWTH)
    assert set(effect.widths) == ({'tau'} if how == FOUND else set())
    runs, done = solved(*runs_and_nodes, [effect])
    found, step, size = estimates(runs, done, [effect])

    A, c, y = dense(runs, done, effect)
    cover = free_values(done.unknowns, done.solution.covariance)[:, done.unknowns.kept]
    seen = np.flatnonzero(np.diag(cover) > 0)
    whole = np.hstack([A[:, seen], c])
    normal = whole.T @ whole
    count = len(seen)
    normal[:count, :count] += done.roughness.precision[np.ix_(seen, seen)]
    normal[count:, count:] += np.diag(effect.precision(size))
    scale = 1.0 / np.sqrt(np.diag(normal))
    joint = scale[:, None] * np.linalg.inv(scale[:, None] * normal * scale) * scale
    value = joint @ (whole.T @ y)
    u = np.sqrt(np.diag(found.covariance))
    assert np.max(np.abs(step) / u) > 5.0
    assert np.max(np.abs(step - value[count:]) / u) < 0.05
    # the covariance is that of the first iteration, where poses differ by micrometres
    away = np.abs(found.covariance - joint[count:, count:])
    assert np.max(away / np.outer(u, u)) < 3e-3

    own = done.solution.covariance + found.change @ found.covariance @ found.change.T
    kept = done.unknowns.kept[seen]
    given, wanted = np.sqrt(np.diag(own)[kept]), np.sqrt(np.diag(joint)[:count])
    assert_allclose(given, wanted, rtol=3e-3)
    assert np.max(wanted / np.sqrt(np.diag(done.solution.covariance)[kept])) > 1.1


def test_coefficients_of_a_file_are_estimated_from_the_data(runs_and_nodes):
    runs, _ = runs_and_nodes
    until = float(runs[0].recording.samples.time[-1])
    effect = one(
        'thermal_axis_expansion', tau=100 * until, until=until, order=2.0, S_X=1e-5, S_X_2=0.0
    )
    _, done = solved(*runs_and_nodes)
    found, _, _ = estimates(runs, done, [effect])
    value, u = found.effects[0].values[0, 0], np.sqrt(found.covariance[0, 0])
    true = 20e-6 / 0.3
    assert abs(value - true) < 0.2 * true
    assert 0 < u < 0.2 * true


def test_what_the_data_do_not_see_stays_as_the_file_says_uncertain_by_its_size(runs_and_nodes):
    delays = one('servo_mismatch', T_X=1e-4, T_Y=1e-4, T_Z=1e-4)
    runs, done = solved(*runs_and_nodes, [delays])
    found, _, _ = estimates(runs, done, [delays])
    common = np.full(3, 1.0 / 3.0)  # equal delays shift the points along the path
    u = np.sqrt(common @ found.covariance @ common)
    assert found.effects[0].values[0] @ common == pytest.approx(1e-4, rel=0.3)
    assert 0.2e-4 < u < 2e-4
    change = found.change @ common
    assert np.abs(change[done.unknowns.blocks['EXX']]).max() * 1e-4 < 1e-7


@pytest.mark.parametrize(
    ('name', 'parameters'),
    [
        ('thermal_axis_expansion', GROWTH),
        ('cyclic_error', {'period': 0.04, 'S_X': 3e-6, 'C_X': 1e-6}),
        ('corner_rounding', {'l': 0.02, 'A': 1e-5}),
    ],
)
def test_columns_are_the_derivatives_of_the_displacement(name, parameters):
    effect = one(name, FOUND, **parameters)
    assert effect.widths
    machine = some_machine()
    base, rng = probe_state(machine), np.random.default_rng(1)
    units = rng.standard_normal((3, 9, 3))
    units /= np.linalg.norm(units, axis=2, keepdims=True)
    state = replace(
        base,
        q=rng.uniform(machine.lower, machine.upper, (9, 3)),
        **dict(zip(('direction', 'before', 'after'), units, strict=True)),
        **{k: np.repeat(getattr(base, k), 9, axis=0) for k in ('side', 'beam', 'speed')},
        **{k: rng.uniform(0, 0.03, 9) for k in ('from_corner', 'to_corner')},
        time=np.linspace(0, 80, 9),
        duration=80.0,
    )
    columns = effect.columns(state, 0)
    for k in range(effect.size):
        shape = k >= effect.values.size
        step = np.zeros(effect.size)
        step[k] = 1e-4 * (list(effect.widths.values())[k - effect.values.size] if shape else 1.0)
        moved = effect.moved(step).displacement(state, 0) - effect.moved(-step).displacement(
            state, 0
        )
        size = np.abs(columns[:, :, k]).max()
        assert size > 0
        assert_allclose(moved / (2 * step[k]), columns[:, :, k], atol=1e-4 * size)


def test_pieces_are_moved_back_by_the_displacement(runs_and_nodes):
    runs, nodes = runs_and_nodes
    shift = np.array([1e-5, -2e-5, 5e-6])
    still = dict(zip(('D_X', 'D_Y', 'D_Z'), shift, strict=True))
    effect = one('thermal_structure_drift', tau=1e-3, order=1.0, **still)
    moved = correct_runs(runs, [effect], nodes, None)[0]
    taken_off = runs[0].pose.rotate(runs[0].pieces.xyz - moved.pieces.xyz)
    assert_allclose(taken_off, np.tile(shift, (len(taken_off), 1)), atol=1e-12)


def test_every_run_has_a_drift_of_its_own():
    drift, servo = REGISTRY['thermal_structure_drift'], REGISTRY['servo_mismatch']
    shape = {'tau': 50.0, 'until': 100.0, 'order': 1.0}
    two = [AppliedEffect(drift, {**shape, 'D_X': v}) for v in (1e-6, 2e-6)]
    assert removable_effect(two, FILE).values.tolist() == [[1e-6], [2e-6]]
    lag = [AppliedEffect(servo, {'T_X': 1e-5})] * 2
    assert removable_effect(lag, FILE).values.tolist() == [[1e-5]]
    state = replace(probe_state(some_machine()), duration=100.0)
    effect = removable_effect(two, FILE)
    columns = effect.columns(state, 1)
    assert effect.acting(1).tolist() == [1] and columns.shape[2] == 1 and columns[0, 0, 0] != 0


def test_drifts_of_two_runs_are_told_apart():
    cells = small_cell(drift=(10e-6, 0, 0)), small_cell(drift=(-5e-6, 0, 0))
    runs, nodes = prepare_runs(
        [c.recording(rate=20.0, noise_seed=k) for k, c in enumerate(cells)], CONFIG
    )
    end = float(runs[0].recording.samples.time[-1])
    shape = {'tau': 200.0, 'until': end, 'order': 1.0}
    drift = AppliedEffect(REGISTRY['thermal_structure_drift'], {**shape, 'D_X': 1e-6})
    effect = removable_effect([drift, drift], FILE)
    kept, done = solved(runs, nodes, [effect])
    found, _, _ = estimates(kept, done, [effect])
    one_after_other = found.taken_off(SimpleNamespace(runs=kept, joint=done)).stated[0]
    reached = 1.0 - np.exp(-end / 200.0)
    for name, true in (('D_X', 10e-6), ('D_X (run 2)', -5e-6)):
        value, u = one_after_other.parameters[name], one_after_other.u[name]
        assert abs(value - true * reached) < 4 * u and u < 1e-6
        assert one_after_other.units[name] == 'm'


def test_waves_that_no_table_holds_are_in_the_uncertainty_of_positioning(runs_and_nodes):
    runs, done = solved(*runs_and_nodes)
    wave = one('cyclic_error', period=0.01, S_X=4e-6, C_X=3e-6)
    missing = missing_in_tables(SimpleNamespace(runs=runs, joint=done), [wave])
    q = np.linspace(0.0, 0.3, 301)
    rows = done.unknowns.bases['X'].matrix(q)
    block = done.unknowns.blocks['EXX']
    variance = np.einsum('ij,jk,ik->i', rows, missing[block, block], rows)
    assert np.sqrt(variance.mean()) == pytest.approx(5e-6 / np.sqrt(2), rel=0.1)
    others = [done.unknowns.blocks[m] for m in MOTIONS if m != 'EXX']
    assert not any(missing[part].any() for part in others)


def refused(tmp_path, text, **options):
    file = tmp_path / 'effects.yaml'
    file.write_text(text)
    recording = SimpleNamespace(machine=some_machine())
    with pytest.raises(ConfigError) as caught:
        calibrate_with_effects([recording], str(file), None, **options)
    return str(caught.value)


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('- effect: tracker_noise\n  parameters: {level_range: 2.0}\n', 'is not a displacement'),
        ('- effect: table_resolution\n  parameters: {EYX@0.0..0.05: 1.0e-6}\n', 'to the tables'),
        ('- effect: gremlins\n  parameters: {}\n', "'gremlins' is unknown; possible: backlash"),
        (
            '- effect: backlash\n  parameters: {B_X: 1.0e-6}\n  units: {B_X: mm}\n',
            "its unit is 'm'",
        ),
        ('[]\n', 'names no effect'),
    ],
)
def test_what_cannot_be_taken_off_is_refused(tmp_path, text, said):
    message = refused(tmp_path, text)
    assert said in message and 'effects.yaml' in message


def test_stops_have_neither_feed_nor_direction(tmp_path):
    message = refused(
        tmp_path, '- effect: backlash\n  parameters: {B_X: 1.0e-6}\n', method='standstill'
    )
    assert 'use the method otf' in message


def cause(confidence=1.0, *others):
    return CauseWords(confidence, others, 'a cause')


def test_reversal_is_left_to_its_own_choice_unless_that_is_off():
    found = [one('backlash', FOUND, B_X=1e-6), one('servo_mismatch', FOUND, T_X=1e-6)]

    def names(reversal):
        config = CalibrationConfig(reversal=reversal)
        return [t.effect.name for t in _to_take(found, [cause(), cause()], config)[0]]

    assert names('auto') == names('tables') == ['servo_mismatch']
    assert names('none') == ['backlash', 'servo_mismatch']


def test_unsure_cause_is_taken_off_with_a_warning():
    servo = [one('servo_mismatch', FOUND, T_X=1e-5)]
    (warning,) = _to_take(servo, [cause(0.8, 'backlash', 'vibration')], CONFIG)[1]
    assert 'servo_mismatch, with a confidence of 0.80' in warning
    assert 'indistinguishable from vibration' in warning  # reversal has its own choice
    assert not _to_take(servo, [cause()], CONFIG)[1]


def test_effects_are_listed_with_value_u_and_unit(runs_and_nodes):
    effect = one('thermal_axis_expansion', FOUND, **GROWTH)
    runs, done = solved(*runs_and_nodes, [effect])
    found, _, _ = estimates(runs, done, [effect])
    stated = found.taken_off(SimpleNamespace(runs=runs, joint=done)).stated
    assert set(stated[0].u) == {'tau', 'S_X', 'S_Y', 'S_X_2'} and stated[0].how == FOUND
    assert stated[0].units['S_X_2'] == 'm/m' and stated[0].units['tau'] == 's'


@dataclass(frozen=True)
class Plain:
    """What is looked at of a plain calibration."""

    run_id: str
    warnings: tuple
    runs: tuple = (None,)
    effects_sentence: str = ''
    applied: tuple = ()
    reversal: Reversal = field(default_factory=lambda: Reversal('none', {}, {}))


def test_what_is_not_taken_off_is_said_with_what_holds_it():
    """Backlash is in the reversal tables: that is what --effects auto has to say of it."""
    reversal = Reversal('constant', {}, {}, backlash={'X': Backlash(5.2e-6, 0.2e-6)})
    plain = Plain('1', (), reversal=reversal)
    told = CauseWords(1.0, (), 'backlash of X', ('X',))
    found = CausesToRemove((told,), ((AppliedEffect(REGISTRY['backlash'], {'B_X': 5e-6}),),))
    words = pair_with_corrected(plain, None, found, CONFIG, 'There it is.').effects_sentence
    assert 'Backlash of X is in the reversal tables (X 5.20 +/- 0.40 um, k = 2: ' in words
    assert words.endswith('nothing else to remove.') and 'No effect was removed' not in words
    waves = CausesToRemove((), ((),), ('cyclic error of X',))
    words = pair_with_corrected(plain, None, waves, CONFIG, 'There it is.').effects_sentence
    assert 'Cyclic error of X is in the error tables, which follow it' in words


def test_gap_of_unknown_cause_takes_nothing_off_and_warns(monkeypatch):
    plain = Plain('1', ('other',))
    nothing = CausesToRemove((), ((),))
    made = pair_with_corrected(plain, None, nothing, CONFIG, 'A gap that no effect explains.')
    diagnosis = SimpleNamespace(verdict='unknown', calibration=made)
    monkeypatch.setattr(above, 'diagnose', lambda *given, **more: diagnosis)
    done = calibrate_with_effects([SimpleNamespace(name='run')], 'auto', None)
    assert done.applied == () and done.run_id == '1'
    assert 'no effect explains. No effect was removed' in done.warnings[0]
    assert done.warnings[1] == 'other'

# SPDX-License-Identifier: Apache-2.0
"""What every effect of the registry keeps to; a new one is tested once it is registered."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from core_cells import some_machine
from effect_cells import driven_state

from otf_core.effects import EVERY, REGISTRY, AppliedEffect, BelongsTo, base
from otf_core.effects.effects_page import catalogue_markdown
from otf_core.effects.effects_yaml import read_effects, write_effects
from otf_core.effects.state import probe_state
from otf_core.errors import ConfigError
from otf_core.model.sections import DECLARABLE

UNITS = {'', 'm', 'rad', 's', 'Hz', 'm/m', 'rad/m', 'm/rad', 'm/rad^2'}
DISPLACING = [n for n, e in REGISTRY.items() if e.belongs_to is not BelongsTo.NOISE]
every_effect = pytest.mark.parametrize('name', REGISTRY)
displacing = pytest.mark.parametrize('name', DISPLACING)


@pytest.fixture(scope='module')
def state():
    return driven_state()


def shape_of(name):
    effect = REGISTRY[name]
    return effect.complete_shape(effect.shapes(probe_state(some_machine('w-Y-b-X-Z-t')))[0])


def drawn(name, seed=1):
    """A shape worth trying, with coefficients of any size."""
    effect, shape = REGISTRY[name], shape_of(name)
    names = effect.terms(probe_state(some_machine('w-Y-b-X-Z-t')), shape).names
    values = 1e-6 * np.random.default_rng(seed).standard_normal(len(names))
    return shape | dict(zip(names, values.tolist(), strict=True))


def at(state, **changes):
    """The same state with some of its arrays replaced."""
    return dataclasses.replace(state, **changes)


# ---------------------------------------------------------------- words and names


@every_effect
def test_effect_says_what_it_is(name):
    words = REGISTRY[name].words
    for text in vars(words).values():
        assert isinstance(text, str) and len(text) > 2 and not text.endswith('.')


def test_words_are_those_of_the_catalogue():
    assert list(base.words_of_effects()) == list(EVERY)


def test_generated_documentation_is_current():
    document = Path(__file__).parents[3] / 'docs' / 'effects.md'
    assert document.read_text(encoding='utf-8') == catalogue_markdown(), (
        'run python3 -m otf_core.effects.effects_page docs/effects.md'
    )


@every_effect
def test_names_and_units_belong_together(name, state):
    effect = REGISTRY[name]
    for shape in (shape_of(name), *effect.shapes(state)[:3]):
        terms = effect.terms(state, shape)
        count = len(terms.names)
        assert len({*terms.names, *effect.shape_names}) == count + len(effect.shape_names)
        assert len(terms.units) == len(terms.axes) == count
        assert {*terms.units, *effect.shape_units} <= UNITS
        assert set(terms.axes) <= {'X', 'Y', 'Z', ''}
        assert terms.columns.shape == (len(state), 3, count)
        assert np.all(np.isfinite(terms.columns))


@every_effect
def test_unknown_parameters_are_named(name, state):
    with pytest.raises(ConfigError, match=rf'^{name}: wobble: unknown'):
        REGISTRY[name].displacement(state, shape_of(name) | {'wobble': 1.0})


@every_effect
def test_missing_and_impossible_shapes_are_named(name, state):
    effect = REGISTRY[name]
    for parameter in effect.shape:
        key, shape = parameter.name, shape_of(name)
        for wrong in (-3.0, np.nan):
            with pytest.raises(ConfigError, match=rf'^{name}: {key}: .*out of range'):
                effect.displacement(state, shape | {key: wrong})
        del shape[key]
        if parameter.default is None:
            with pytest.raises(ConfigError, match=rf'^{name}: {key}: missing'):
                effect.displacement(state, shape)


@every_effect
def test_effects_yaml_keeps_every_digit(name, tmp_path):
    machine = some_machine('w-Y-b-X-Z-t')
    given = AppliedEffect(REGISTRY[name], drawn(name))
    write_effects(tmp_path / 'effects.yaml', [given], machine)
    assert read_effects(tmp_path / 'effects.yaml', machine) == (given,)


# ---------------------------------------------------------------- displacement


@displacing
def test_displacement_is_linear_in_the_coefficients(name, state):
    effect = REGISTRY[name]
    shape, terms = shape_of(name), effect.terms(state, shape_of(name))
    rng = np.random.default_rng(2)
    a, b = rng.standard_normal((2, len(terms.names)))

    def moved(values):
        return effect.displacement(state, shape | dict(zip(terms.names, values, strict=True)))

    both = moved(2.0 * a - 3.0 * b)
    np.testing.assert_allclose(2.0 * moved(a) - 3.0 * moved(b), both, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(moved(a), terms.columns @ a, rtol=1e-9, atol=1e-9)


@displacing
def test_points_are_taken_in_blocks(name, state, monkeypatch):
    whole = REGISTRY[name].displacement(state, drawn(name))
    assert np.abs(whole).max() > 0
    monkeypatch.setattr(base, 'POINTS_AT_ONCE', 501)
    np.testing.assert_array_equal(REGISTRY[name].displacement(state, drawn(name)), whole)


def degenerate_states(state):
    """States at the edge of what can be: name and state."""
    machine, count = state.machine, len(state)
    zero, upright = np.zeros(count), np.tile([0.0, 0.0, 1.0], (count, 1))
    yield 'one point', state.part(slice(0, 1))
    yield 'standing still', at(state, speed=zero, direction=np.zeros((count, 3)))
    yield 'no axis has moved yet', at(state, side=np.zeros((count, 3)))
    yield 'no time passes', at(state, time=zero, duration=0.0)
    yield 'no corners', at(state, before=state.direction, after=state.direction)
    yield 'there and back', at(state, before=-state.direction, after=-state.direction)
    yield 'at a corner', at(state, from_corner=zero, to_corner=zero)
    yield 'beam straight up', at(state, beam=upright, R_machine_tracker=np.eye(3))
    yield 'beam straight down', at(state, beam=-upright, R_machine_tracker=np.eye(3))
    yield 'tables unknown', at(state, tables=None)
    for end in (machine.lower, machine.upper):
        yield 'end of all ranges', at(state, q=np.tile(end, (count, 1)))


@every_effect
def test_displacement_is_finite_in_degenerate_states(name, state):
    effect = REGISTRY[name]
    for what, edge in degenerate_states(state):
        for shape in (shape_of(name), *effect.shapes(edge)[:3]):
            assert np.all(np.isfinite(effect.terms(edge, shape).columns)), what


# ---------------------------------------------------------------- facts that others rely on


@every_effect
def test_shapes_to_try_are_complete(name, state):
    effect = REGISTRY[name]
    shapes = effect.shapes(state)
    assert 1 <= len(shapes) < 1000
    for shape in shapes:
        assert set(shape) <= set(effect.shape_names)
        assert set(effect.complete_shape(shape)) == set(effect.shape_names)
        assert set(effect.loose(shape)) <= set(shape)
        assert all(width > 0 for width in effect.loose(shape).values())
    assert effect.refine in ('', *effect.shape_names)
    assert (effect.refine_width > 0) == bool(effect.refine)
    assert effect.material_um > 0


@pytest.mark.parametrize('name', [n for n, e in REGISTRY.items() if e.wave])
def test_waves_repeat_as_they_say(name, state):
    effect, wave = REGISTRY[name], REGISTRY[name].wave
    assert dict(zip(effect.shape_names, effect.shape_units, strict=True))[wave.parameter] == (
        'Hz' if wave.in_time else 'm'
    )
    shape = effect.complete_shape({wave.parameter: wave.probe})
    columns = effect.terms(state, shape).columns
    later = {'time': state.time + 1 / wave.probe} if wave.in_time else {'q': state.q + wave.probe}
    once, half = (
        {k: getattr(state, k) + part * (v - getattr(state, k)) for k, v in later.items()}
        for part in (1.0, 0.5)
    )
    np.testing.assert_allclose(effect.terms(at(state, **once), shape).columns, columns, atol=1e-9)
    assert np.abs(effect.terms(at(state, **half), shape).columns - columns).max() > 1.0


@pytest.mark.parametrize(
    'name',
    [n for n, e in REGISTRY.items() if e.stays_in_place or e.belongs_to is BelongsTo.TABLES],
)
def test_what_stays_in_place_depends_on_the_place_alone(name, state):
    effect, shape = REGISTRY[name], shape_of(name)
    other = at(
        state, time=state.time[::-1], speed=state.speed + 0.1, direction=-state.direction,
        side=-state.side, before=state.after, after=state.before,
        from_corner=state.to_corner, to_corner=state.from_corner,
    )  # fmt: skip
    columns = effect.terms(state, shape).columns
    np.testing.assert_array_equal(effect.terms(other, shape).columns, columns)


@pytest.mark.parametrize('name', [n for n, e in REGISTRY.items() if e.own_per_run])
def test_what_each_run_has_of_its_own_changes_with_time(name, state):
    effect, shape = REGISTRY[name], shape_of(name)
    start = effect.terms(at(state, time=np.zeros(len(state))), shape).columns
    np.testing.assert_allclose(start, 0, atol=1e-12)
    assert np.any(effect.terms(state, shape).columns)


@every_effect
def test_contributions_to_the_budget_follow_what_is_declared(name, state):
    effect = REGISTRY[name]
    for one in effect.contributions:
        terms = effect.terms(state, effect.complete_shape(one.shape))
        ones = one.size(terms, state, [1.0] * len(one.keys))
        assert ones.shape == (len(terms.names),) and np.all(ones >= 0) and np.any(ones)
        assert not np.any(one.size(terms, state, [0.0] * len(one.keys)))
        assert np.any(np.einsum('nik,k->ni', terms.columns, ones))


def test_every_declared_uncertainty_acts_through_one_effect():
    keys = [k for e in REGISTRY.values() for c in e.contributions for k in c.keys]
    assert sorted(keys) == sorted(DECLARABLE)

# SPDX-License-Identifier: Apache-2.0
"""The one size that stands for a cause: of every effect, with its unit and uncertainty."""

import numpy as np
import pytest
from core_cells import some_machine
from engine_cells import cause_of, holding, noise, solved_rows, trace_of

from otf_core.diagnosis.answer import name_and_sizes, sentence_of
from otf_core.diagnosis.cause_parameters import (
    Curve,
    chosen_sizes,
    fitted_causes,
    sizes_of,
    sizes_words,
)
from otf_core.diagnosis.result import Gap, NamedCause
from otf_core.diagnosis.weighing import Unnamed
from otf_core.effects import REGISTRY
from otf_core.effects.base import Coefficients
from otf_core.effects.state import probe_state

MACHINE = some_machine('w-Y-b-X-Z-t')
PER_TRAVEL = {'rad/m': 'rad'}
"""Unit of a coefficient that is stated over the travel of an axis."""


def coefficients(name, scale=1.0):
    """One value for every coefficient of an effect, the later the larger."""
    effect, state = REGISTRY[name], probe_state(MACHINE)
    shape = effect.complete_shape({**dict.fromkeys(effect.shape_names, 1.0), 'order': 3.0})
    terms = effect.terms(state, shape)
    value = {n: scale * 1e-6 * (k + 1.0) for k, n in enumerate(terms.names)}
    axes = tuple(dict.fromkeys(a for a in terms.axes if a))
    units = dict(zip(terms.names, terms.units, strict=True))
    return Coefficients(value, dict.fromkeys(value, 1.0), axes, shape, MACHINE), units


@pytest.mark.parametrize('name', sorted(set(REGISTRY) - {'tracker_noise'}))
def test_size_is_made_of_the_coefficients_in_their_unit(name):
    (found, units), (twice, _) = coefficients(name), coefficients(name, 2.0)
    for size, larger in zip(REGISTRY[name].sizes(found), REGISTRY[name].sizes(twice), strict=True):
        assert size.parts and '_' not in size.of + size.remark
        used = {units[n] for part in size.parts for n in part if n in units}
        assert {PER_TRAVEL.get(u, u) for u in used} == {size.unit}
        values, doubled = ([c.of(p) for p in s.parts] for c, s in ((found, size), (twice, larger)))
        np.testing.assert_allclose(doubled, 2.0 * np.array(values))
        assert np.linalg.norm(values) > 0.0


@pytest.mark.parametrize(
    ('name', 'value', 'shape', 'sizes'),
    [
        ('backlash', {'B_X': 5e-6}, {}, [('of X', 5e-6, 'm')]),
        ('thermal_axis_expansion', {'S_X': 2e-5, 'S_X_2': 9e-6, 'S_X_3': 1e-6}, {'order': 3.0},
         [('of X', 2.2e-5, 'm/m')]),
        ('cyclic_error', {'S_X': 3e-6, 'C_X': 4e-6}, {'period': 0.01}, [('of X', 5e-6, 'm')]),
        ('vibration', {'S_X': 3e-6, 'C_X': -4e-6}, {'frequency': 12.3},
         [('along X', 5e-6, 'm')]),
        ('table_tilt', {'tilt_Y_by_X': 4e-5, 'tilt_X_by_Z': 1e-5}, {},
         [('about Y by X', 4e-5 * float(np.ptp([MACHINE.lower[0], MACHINE.upper[0]])), 'rad')]),
        ('servo_mismatch', {'T_X': 3e-5, 'T_Y': -1e-5}, {}, [('of X behind Y', 4e-5, 's')]),
        ('thermal_structure_drift', {'D_X': 1e-7, 'D_Y': 0.0, 'D_Z': -8e-6}, {'order': 1.0},
         [('along Z', -8e-6, 'm')]),
        ('thermal_structure_drift', {'D_X': 3e-6, 'D_Y': 4e-6, 'D_Z': 0.0}, {'order': 1.0},
         [('', 5e-6, 'm')]),
        ('direction_dependent_tables', {'EXX_1': 3e-6}, {}, [('of EXX', 3e-6 / 3**0.5, 'm')]),
    ],
)  # fmt: skip
def test_size_is_what_a_service_engineer_asks_for(name, value, shape, sizes):
    found = Coefficients(value, dict.fromkeys(value, 1.0), ('X',), shape, MACHINE)
    for size, (of, wanted, unit) in zip(REGISTRY[name].sizes(found), sizes, strict=False):
        values = [found.of(part) for part in size.parts]
        got = values[0] if len(values) == 1 else float(np.linalg.norm(values))
        assert (size.of, size.unit) == (of, unit)
        assert got == pytest.approx(wanted)


def test_uncertainty_of_an_amplitude_is_that_of_its_parts():
    """Along the vector of sine and cosine, by the covariance of both."""
    cause = cause_of(REGISTRY['cyclic_error'], period=0.031)
    rows = holding(trace_of(cause, S_X=4e-6, C_X=3e-6) + noise(3))
    (part,) = fitted_causes([cause], rows)
    found = {s.of: s for s in sizes_of(part, rows.states, ())}
    place = [part.names.index(n) for n in ('S_X', 'C_X')]
    way = part.value[place] / np.linalg.norm(part.value[place])
    wanted = np.sqrt(way @ part.covariance[np.ix_(place, place)] @ way)
    size = found['of X']
    assert size.u == pytest.approx(wanted, rel=1e-6)
    assert abs(size.value - 5e-6) < 3.0 * size.u < 0.2 * size.value
    assert 'period 31 mm' in size.remark


def test_what_no_run_shows_is_in_the_uncertainty():
    """Equal delays of all axes leave no trace: only differences are sure."""
    cause = cause_of(REGISTRY['servo_mismatch'])
    rows = holding(trace_of(cause, T_X=4e-5) + noise(3))
    (part,) = fitted_causes([cause], rows)
    (size,) = sizes_of(part, rows.states, ())
    assert size.of.startswith('of X behind ')
    assert abs(size.value - 4e-5) < 3.0 * size.u < 0.2 * size.value
    assert part.u.max() > 5.0 * size.u


def test_an_effect_of_many_parts_is_stated_as_its_displacement():
    cause = cause_of(REGISTRY['tracker_angles'])
    rows = holding(trace_of(cause, x8x=5e-6) + noise(3))
    (part,) = fitted_causes([cause], rows)
    (size,) = sizes_of(part, rows.states, ())
    moved = cause.option.plain @ part.value
    pieces = sum(map(len, solved_rows().states))
    assert size.value == pytest.approx(np.sqrt(moved @ moved / pieces))
    assert size.unit == 'm' and size.u > 0.0 and 'rms' in size.remark


def test_free_form_is_stated_by_its_largest_value():
    curve = Curve(
        'B_X', 'X', 'time', 's', (0.0, 1.0, 2.0), (2e-6, 3e-6, -6e-6), (1e-7, 1e-7, 2e-7), 'm', {}
    )
    cause = cause_of(REGISTRY['backlash'])
    (part,) = fitted_causes([cause], holding(trace_of(cause, B_X=4e-6) + noise(3)))
    (size,) = sizes_of(part, solved_rows().states, [curve])
    assert (size.of, size.value, size.u) == ('of X', -6e-6, 2e-7)
    assert 'largest' in size.remark and 'rms 4.04 um' in size.remark


def test_noise_has_a_size_that_was_chosen():
    (size,) = chosen_sizes('tracker_noise', {'level_range': 2.5, 'level_angle': 1.9}, MACHINE)
    assert (size.of, size.words, size.u) == ('of the range', '2.5', None)


def test_headline_names_size_axis_and_expanded_uncertainty():
    cause = cause_of(REGISTRY['backlash'])
    rows = holding(trace_of(cause, B_X=5e-6, B_Z=3e-6) + noise(3))
    (part,) = fitted_causes([cause], rows)
    sizes = sizes_of(part, rows.states, ())
    words = sizes_words(sizes, 'X')
    for size in sizes:
        assert f'{size.of}, {1e6 * size.value:.2f} +/- {2e6 * size.u:.2f} um' in words
    named = NamedCause('backlash', ('X', 'Z'), {}, {}, {}, 1.0, 0.0, 100.0, 1.0, (), sizes=sizes)
    assert name_and_sizes(named).startswith('backlash of ')
    assert ', and of ' in name_and_sizes(named)


def test_sentence_states_what_has_no_name_beside_named_causes():
    gap = Gap(2.9, 1.4, 2.5, 0.2, 92.0, (80.0, 99.0))
    cause = NamedCause('servo_mismatch', ('X',), {}, {}, {}, 2.5, 1.0, 60.0, 0.9, ('backlash',))
    rest = Unnamed(('time', 'z'), 'direction', 'depends on time', 1.0, 0.2, 80.0, (60.0, 99.0), ())
    words = sentence_of('partly_explained', gap, [cause], None, rest)
    assert words == (
        'The gap of 2.50 um is partly explained by servo mismatch, indistinguishable from '
        'backlash. The rest depends on time. An empirical effect of these inputs leaves 0.20 um.'
    )

# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of machines with rotary axes: effects of their axes, and what a run says of them."""

from functools import cache
from pathlib import Path

import numpy as np

from otf_core.diagnosis.engine.diagnosed_rows import at_most, with_slow_part
from otf_core.diagnosis.weighing import input_words
from otf_core.effects import EVERY, REGISTRY, ROTARY, catalogue
from otf_core.effects.inputs import input_values
from otf_core.effects.state import probe_state, state_in_parts
from otf_core.model.chain import Sight
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Axis, Chain, Machine, TrackerSpec, load_machine
from otf_core.noise.noise_model import NoiseComponent, NoiseModel

BAG = Path(__file__).parents[3] / 'bags' / 'trunnion'


@cache
def machine():
    return load_machine(BAG / 'machine.yaml')


def driven(q, rates, target='nest-1'):
    """State of points of one part."""
    m = machine()
    sight = Sight.of_target(m, target)
    part, time = np.zeros(len(q), dtype=np.int64), np.arange(len(q), dtype=float)
    pose = RigidTransform(np.eye(3), np.array([-1.0, 0.5, 0.7]))
    places = {target: sight.place}
    return sight, state_in_parts(
        m, [target], places, part, part, q, rates, np.sign(rates), time, pose, {}
    )


def scattered(count=7, seed=4):
    rng = np.random.default_rng(seed)
    m = machine()
    q = m.lower + rng.uniform(size=(count, 5)) * (m.upper - m.lower)
    return q, rng.normal(size=(count, 5))


def test_errors_of_axes_displace_the_target_as_a_small_move_of_them():
    q, rates = scattered()
    sight, state = driven(q, rates)
    small, k = 1e-6, machine().column('C')
    moved = q.copy()
    moved[:, k] += small * np.sign(rates[:, k])
    by_exact = sight.nominal(moved) - sight.nominal(q)
    effect = REGISTRY['backlash']
    found = effect.displacement(state, {'B_C': 2.0 * small, 'held': 1.0})
    # nest: turned by the table, the error of a table axis acts at its side of the bed
    assert np.allclose(found, by_exact, atol=1e-12)
    late = REGISTRY['servo_mismatch'].displacement(state, {'T_C': 1e-4})
    moved = q.copy()
    moved[:, k] -= 1e-4 * rates[:, k]
    assert np.allclose(late, sight.nominal(moved) - sight.nominal(q), atol=1e-8)


def test_linear_axes_do_not_move_a_nest_that_the_tracker_sees_from_the_bed():
    state = driven(*scattered())[1]
    found = REGISTRY['backlash'].displacement(state, {'B_X': 1e-5, 'held': 1.0})
    assert not found.any()


def test_inputs_of_rotary_axes():
    q, rates = scattered()
    state = driven(q, rates)[1]
    assert np.array_equal(input_values(state, 'c'), q[:, 4])
    assert np.array_equal(input_values(state, 'sense_a'), np.sign(rates[:, 3]))
    assert np.ptp(input_values(state, 'since_reversal_c')) > 0.0
    assert input_words('a') == 'the position of A'
    assert input_words('sense_c') == 'the sense of travel of C'


def test_effects_of_rotary_axes_are_for_machines_that_have_some():
    linear = Machine('', Chain.parse('w-b-X-Y-Z-t'), {a: Axis(0.0, 1.0, 0.1) for a in 'XYZ'},
                     np.zeros(3), TrackerSpec(1e-6, 1e-6))  # fmt: skip
    assert catalogue(linear) is REGISTRY
    assert not set(ROTARY) & set(REGISTRY)
    offered = catalogue(machine())
    assert set(ROTARY) <= set(offered) < set(EVERY)
    state = probe_state(machine())
    for effect in offered.values():
        for shape in effect.shapes(state)[:2]:
            terms = effect.terms(state, effect.complete_shape(shape))
            assert len(terms.names) == len(terms.units) == len(terms.axes)
            assert terms.columns.shape == (len(state), 3, len(terms.names))
            assert np.all(np.isfinite(terms.columns))


def test_simulation_has_the_slow_noise_that_stops_are_too_short_to_show():
    stops = NoiseModel(*(NoiseComponent(1e-6, 0.6e-6, 0.05) for _ in range(3)))
    fitted = NoiseModel(*(NoiseComponent(1.5e-6, 0.5e-6, 0.4) for _ in range(3)))
    for length, time in ((0.5, 0.4), (0.2, 0.2), (0.02, 0.05)):
        for part in with_slow_part(stops, fitted, length):
            assert part.correlation_time == time
            assert (part.level, part.white) == (1e-6, 0.6e-6)
    for part in at_most(stops, fitted):
        assert part.white == 0.5e-6
        assert np.isclose(part.slow, 0.8e-6)

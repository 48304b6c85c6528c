# SPDX-License-Identifier: Apache-2.0
"""Any chain: hand-worked values, first order against exact, exact against plain matrices."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from core_cells import constant_tables, error_of, some_machine, zero_tables
from scipy.linalg import expm

from otf_core.errors import ShapeError
from otf_core.model.chain import Sight, displacement, exact_position, nominal_position
from otf_core.model.machine import machine_from_dict
from otf_core.model.motions import DIRECTIONS
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.sim.cell import random_tables

CHAINS = [
    '-'.join(['w', *order[:k], 'b', *order[k:], 't'])
    for order in permutations('XYZ')
    for k in range(4)
]


@pytest.mark.parametrize('chain', CHAINS)
def test_first_order_is_the_sum_of_the_contract_for_every_chain(chain):
    machine = some_machine(chain)
    rng = np.random.default_rng(len(chain))
    tables = random_tables(machine, 5e-5, rng)
    q = rng.uniform(machine.lower, machine.upper, (8, 3))
    by_hand = error_of(tables, q)
    # both are sums of some twenty terms below 1 mm: rounding only
    np.testing.assert_allclose(displacement(tables, q), by_hand, atol=1e-17, rtol=0)


def matrix_position(tables, q):
    """Exact position by plain 4x4 matrices, one point, in the order of the chain string."""
    machine = tables.machine
    c0y, b0z, a0z = (tables.squareness[k].value for k in ('C0Y', 'B0Z', 'A0Z'))
    across = np.sin([b0z, -a0z])
    direction = {
        'X': np.array([1.0, 0, 0]),
        'Y': np.array([-np.sin(c0y), np.cos(c0y), 0]),
        'Z': np.array([*across, np.sqrt(1 - across @ across)]),
    }

    def shift(vector):
        matrix = np.eye(4)
        matrix[:3, 3] = vector
        return matrix

    sequence = str(machine.chain).split('-')[1:-1]
    base = sequence.index('b')
    total = np.eye(4)
    for place, axis in enumerate(sequence):
        if axis == 'b':
            continue
        position = q['XYZ'.index(axis)]
        error = [float(tables.motions[f'E{d}{axis}'].at(position)) for d in 'XYZABC']
        turn = np.zeros((4, 4))
        turn[:3, :3] = np.cross(error[3:], np.eye(3)).T  # times v gives error x v
        travel, imperfection = shift(position * direction[axis]), shift(error[:3]) @ expm(turn)
        total = total @ (travel @ imperfection if place > base else imperfection @ travel)
    return (total @ [*machine.target_offset, 1.0])[:3] - machine.target_offset


@pytest.mark.parametrize('chain', CHAINS)
def test_exact_position_equals_plain_matrices_for_every_chain(chain):
    machine = some_machine(chain)
    rng = np.random.default_rng(sum(map(ord, chain)))
    tables = random_tables(machine, 5e-3, rng)  # large, so that every product shows
    q = rng.uniform(machine.lower, machine.upper, (5, 3))
    expected = [matrix_position(tables, point) for point in q]
    np.testing.assert_allclose(exact_position(tables, q), expected, atol=1e-14, rtol=0)  # rounding


@pytest.mark.parametrize('chain', ['w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t', 'w-Z-Y-X-b-t'])
def test_first_order_differs_from_exact_by_second_order_only(chain):
    machine = some_machine(chain)
    rng = np.random.default_rng(11)
    tables = random_tables(machine, 1e-3, rng)
    q = rng.uniform(machine.lower, machine.upper, (40, 3))

    def difference(factor):
        scaled = tables.scaled(factor)
        return np.abs(exact_position(scaled, q) - q - displacement(scaled, q)).max()

    # third-order terms are a thousandth of the second-order ones here
    assert difference(1.0) / difference(0.1) == pytest.approx(100.0, rel=0.05)
    assert difference(0.1) / difference(0.01) == pytest.approx(100.0, rel=0.01)


def test_machine_without_errors_is_exactly_where_it_was_told():
    machine = some_machine('w-Y-b-X-Z-t')
    q = np.random.default_rng(0).uniform(machine.lower, machine.upper, (20, 3))
    np.testing.assert_array_equal(displacement(zero_tables(machine), q), 0.0)
    np.testing.assert_array_equal(nominal_position(machine, q), q)
    np.testing.assert_allclose(exact_position(zero_tables(machine), q), q, atol=1e-16)  # rounding


@pytest.mark.parametrize(
    ('name', 'axis', 'direction'),
    [('C0Y', 1, (-1, 0, 0)), ('B0Z', 2, (1, 0, 0)), ('A0Z', 2, (0, -1, 0))],
)
def test_positive_squareness_tilts_the_positive_axis_as_the_contract_says(name, axis, direction):
    tables = constant_tables(some_machine(ranges=((0, 1), (0, 1), (0, 1))), **{name: 1e-5})
    q = np.zeros((1, 3))
    q[0, axis] = 1.0
    for error in (displacement(tables, q)[0], exact_position(tables, q)[0] - q[0]):
        # exact: the tilted axis is shorter by 1e-10 / 2
        np.testing.assert_allclose(error, 1e-5 * np.array(direction), atol=1e-10)


def test_tables_are_linear_between_nodes_and_constant_outside():
    machine = some_machine()
    tables = zero_tables(machine)
    bow = MotionTable(np.array([0.1, 0.2, 0.25]), np.array([1e-6, 3e-6, -1e-6]), np.zeros(3))
    tables = replace(tables, motions={**tables.motions, 'EYX': bow})
    x = np.array([-5.0, 0.0, 0.1, 0.15, 0.2, 0.225, 0.25, 0.3, 5.0])
    q = np.stack([x, 0 * x, 0 * x], axis=1)
    expected = [1e-6, 1e-6, 1e-6, 2e-6, 3e-6, 1e-6, -1e-6, -1e-6, -1e-6]
    np.testing.assert_allclose(displacement(tables, q)[:, 1], expected, atol=1e-20)


LINEAR = {'min': -0.3, 'max': 0.3, 'table_pitch': 0.1}


def machine_of(chain, rng=None, link='w'):
    """A machine with any rotary axes the chain names."""
    axes = {}
    for letter in chain.replace('-', ''):
        if letter in 'XYZ':
            axes[letter] = LINEAR
        elif letter in 'ABC':
            direction, centre = np.eye(3)['ABC'.index(letter)], np.zeros(3)
            if rng is not None:
                direction, centre = rng.normal(size=3), rng.uniform(-0.2, 0.2, 3)
            axes[letter] = {
                'kind': 'rotary',
                'min': -2.0,
                'max': 2.0,
                'table_pitch': 0.5,
                'direction': direction.tolist(),
                'centre': centre.tolist(),
            }
    data = {
        'name': 'm',
        'chain': chain,
        'axes': axes,
        'target_offset': [0.02, -0.03, -0.15],
        'tracker': {'u_range': 5e-7, 'u_angle': 2e-6, 'link': link},
        'targets': {'nest': {'link': 'w', 'place': [0.2, 0.03, 0.1], 'u': 1e-3}},
    }
    return machine_from_dict(data)


def constant(machine, size=0.0, name=None):
    """Tables that are zero, but one error that is the same everywhere."""
    motions = {
        m: MotionTable(np.zeros(1), np.full(1, size if m == name else 0.0), np.zeros(1))
        for m in machine.motions
    }
    square = {n: ScalarError(size if n == name else 0.0) for n in machine.squareness}
    location = {n: ScalarError(size if n == name else 0.0) for n in machine.location}
    return ErrorTables(machine, motions, square, location)


def random_chain(rng):
    letters = list('XYZ') + list(rng.permutation(list('ABC'))[: rng.integers(0, 3)])
    order = [str(a) for a in rng.permutation(letters)]
    order.insert(int(rng.integers(0, len(order) + 1)), 'b')
    return '-'.join(['w', *order, 't'])


def positions(machine, rng, count=3):
    return rng.uniform(machine.lower, machine.upper, (count, len(machine.axis_names)))


@pytest.mark.parametrize('seed', range(30))
def test_columns_are_the_differences_of_the_exact_chain(seed):
    rng = np.random.default_rng(seed)
    machine, h = machine_of(random_chain(rng), rng), 1e-5
    q = positions(machine, rng)
    pairs = [('w', 't', machine.target_offset), ('b', 't', machine.target_offset)]
    pairs += [('b', 'w', np.array([0.2, 0.03, 0.1]))]
    for frame, link, place in pairs:
        sight = Sight(machine, frame, link, place)
        seen = sight.at(q)
        columns = {
            f'E{d}{a}': seen.motions[a][:, :, k]
            for a in seen.axes
            for k, d in enumerate(DIRECTIONS)
        }
        columns |= seen.scalars
        for name in (*machine.scalars, *machine.motions):
            up, down = (exact_position(constant(machine, s, name), q, sight) for s in (h, -h))
            found = (up - down) / (2 * h)
            expected = columns.get(name, np.zeros_like(found))
            assert np.abs(found - expected).max() < 1e-9, name
            assert np.abs(seen.influence(name) - expected).max() < 1e-15, name
        for k in range(len(machine.axis_names)):
            step = np.eye(len(machine.axis_names))[k] * h
            change = (sight.nominal(q + step) - sight.nominal(q - step)) / (2 * h)
            assert np.abs(change - seen.velocity[:, :, k]).max() < 1e-9


def test_location_error_is_what_the_motions_of_its_line_do():
    """X0C moves the line: EXC = 1 - cos c, EYC = -sin c for an axis on the target side."""
    machine = machine_of('w-b-X-Y-Z-C-t')
    q = np.zeros((5, 4))
    q[:, 3] = np.linspace(-2, 2, 5)
    seen = Sight.of_tool(machine).at(q)
    c = q[:, 3]
    found = (1 - np.cos(c))[:, None] * seen.motions['C'][:, :, 0]
    found -= np.sin(c)[:, None] * seen.motions['C'][:, :, 1]
    assert np.abs(found - seen.scalars['X0C']).max() < 1e-15


def test_axis_turns_the_target_right_handed_about_its_direction():
    machine = machine_of('w-C-b-X-Y-Z-t')
    q = np.array([[0.1, 0.0, 0.0, np.pi / 2]])
    p = nominal_position(machine, q)[0]
    x, y, z = machine.target_offset
    assert np.allclose(p, [-y, 0.1 + x, z])


def test_wrong_shape_is_named():
    machine = machine_of('w-C-b-X-Y-Z-t')
    with pytest.raises(ShapeError, match=r'\(n, 4\)'):
        displacement(constant(machine), np.zeros((2, 3)))

# SPDX-License-Identifier: Apache-2.0
"""Any chain: hand-worked values, first order against exact, exact against plain matrices."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from core_cells import constant_tables, error_by_hand, some_machine, zero_tables
from scipy.linalg import expm

from otf_core.errors import ShapeError
from otf_core.model.chain import Sight, displacement, exact_position, nominal_position
from otf_core.model.machine import machine_from_dict
from otf_core.model.motions import DIRECTIONS
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.sim.cell import random_tables

# T = (0.02, -0.03, -0.15) and q = (0.1, 0.2, -0.1); e_x x L = (0, -Lz, Ly),
# e_y x L = (Lz, 0, -Lx), e_z x L = (-Ly, Lx, 0)
Q = np.array([[0.1, 0.2, -0.1]])
CHAINS = [
    '-'.join(['w', *order[:k], 'b', *order[k:], 't'])
    for order in permutations('XYZ')
    for k in range(4)
]


@pytest.mark.parametrize('chain', ['w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-Z-b-t'])
@pytest.mark.parametrize(
    ('motion', 'per_unit'),
    [
        ('EXX', (1, 0, 0)), ('EYX', (0, 1, 0)), ('EZX', (0, 0, 1)), ('EXY', (1, 0, 0)),
        ('EYY', (0, 1, 0)), ('EZZ', (0, 0, 1)), ('EXZ', (1, 0, 0)),
        ('C0Y', (-0.2, 0, 0)), ('B0Z', (-0.1, 0, 0)), ('A0Z', (0, 0.1, 0)),
    ],
)  # fmt: skip
def test_translations_and_squareness_do_not_depend_on_the_chain(chain, motion, per_unit):
    tables = constant_tables(some_machine(chain), **{motion: 1e-6})
    np.testing.assert_allclose(displacement(tables, Q)[0], 1e-6 * np.array(per_unit), atol=1e-20)


@pytest.mark.parametrize(
    ('chain', 'motion', 'per_unit'),
    [
        # all on the target side; X carries Y and Z: L = (0.02, 0.17, -0.25)
        ('w-b-X-Y-Z-t', 'EAX', (0, 0.25, 0.17)),
        ('w-b-X-Y-Z-t', 'EBX', (-0.25, 0, -0.02)),
        ('w-b-X-Y-Z-t', 'ECX', (-0.17, 0.02, 0)),
        # Y carries Z: L = (0.02, -0.03, -0.25)
        ('w-b-X-Y-Z-t', 'EAY', (0, 0.25, -0.03)),
        ('w-b-X-Y-Z-t', 'EBY', (-0.25, 0, -0.02)),
        ('w-b-X-Y-Z-t', 'ECY', (0.03, 0.02, 0)),
        # Z carries the target only: L = T
        ('w-b-X-Y-Z-t', 'EAZ', (0, 0.15, -0.03)),
        ('w-b-X-Y-Z-t', 'EBZ', (-0.15, 0, -0.02)),
        ('w-b-X-Y-Z-t', 'ECZ', (0.03, 0.02, 0)),
        # Y carries the table: its own travel counts, L = (0.12, 0.17, -0.25)
        ('w-Y-b-X-Z-t', 'EAY', (0, 0.25, 0.17)),
        ('w-Y-b-X-Z-t', 'EBY', (-0.25, 0, -0.12)),
        ('w-Y-b-X-Z-t', 'ECY', (-0.17, 0.12, 0)),
        # X no longer carries Y: L = (0.02, -0.03, -0.25)
        ('w-Y-b-X-Z-t', 'EAX', (0, 0.25, -0.03)),
        ('w-Y-b-X-Z-t', 'ECX', (0.03, 0.02, 0)),
        # table on X on Y on the base; X: target side, Y and own travel
        ('w-X-Y-b-Z-t', 'EAX', (0, 0.25, 0.17)),
        ('w-X-Y-b-Z-t', 'ECX', (-0.17, 0.12, 0)),
        # Y next to the base: not the travel of X, L = (0.02, 0.17, -0.25)
        ('w-X-Y-b-Z-t', 'EBY', (-0.25, 0, -0.02)),
        ('w-X-Y-b-Z-t', 'ECY', (-0.17, 0.02, 0)),
        # everything on the table side; Z next to the base: T and own travel
        ('w-X-Y-Z-b-t', 'EAZ', (0, 0.25, -0.03)),
        ('w-X-Y-Z-b-t', 'EAY', (0, 0.25, 0.17)),
        ('w-X-Y-Z-b-t', 'EBX', (-0.25, 0, -0.12)),
    ],
)
def test_rotation_acts_through_the_lever_of_its_axis(chain, motion, per_unit):
    machine = some_machine(chain)
    expected = np.array(per_unit)
    influence = Sight.of_tool(machine).at(Q).influence(motion)
    np.testing.assert_allclose(influence[0], expected, atol=1e-15)
    tables = constant_tables(machine, **{motion: 1e-6})
    np.testing.assert_allclose(displacement(tables, Q)[0], 1e-6 * expected, atol=1e-20)


@pytest.mark.parametrize('chain', CHAINS)
def test_first_order_is_the_sum_of_the_contract_for_every_chain(chain):
    machine = some_machine(chain)
    rng = np.random.default_rng(len(chain))
    tables = random_tables(machine, 5e-5, rng)
    q = rng.uniform(machine.lower, machine.upper, (8, 3))
    by_hand = [error_by_hand(tables, point) for point in q]
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


def test_matrix_of_the_reference_turns_right_handed():
    tables = constant_tables(some_machine('w-b-X-Y-Z-t', offset=(1.0, 0.0, 0.0)), ECZ=np.pi / 2)
    # a quarter turn about Z takes the offset (1, 0, 0) to (0, 1, 0)
    moved = matrix_position(tables, np.zeros(3))
    np.testing.assert_allclose(moved, [-1.0, 1.0, 0.0], atol=1e-15)


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


def test_own_travel_beyond_the_nodes_still_counts_in_the_lever():
    machine = some_machine('w-Y-b-X-Z-t')
    view = Sight.of_tool(machine).at(np.array([[0.0, 7.0, 0.0]]))
    assert view.places['Y'][1][0].tolist() == [0.02, 6.97, -0.15]


@pytest.mark.parametrize('shape', [(3,), (2, 2), (4, 4), (1, 3, 1)])
def test_positions_of_wrong_shape_are_refused(shape):
    with pytest.raises(ShapeError, match='shape'):
        displacement(zero_tables(some_machine()), np.zeros(shape))


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


@pytest.mark.parametrize(('axis', 'modes'), [('X', 8), ('C', 10), ('A', 10)])
def test_invisible_modes_of_one_joint(axis, modes):
    """Small motions before and after a joint, and of its own line, that its six motions imitate.

    A rigid motion on either side, less the two that commute with a rotation (or the four that
    commute with a translation), as functions of the position of the axis.
    """
    machine = machine_of('w-b-X-Y-Z-C-A-t')
    q = np.zeros((9, 5))
    own = machine.column(axis)
    q[:, own] = np.linspace(-1.5, 1.5, 9) * (0.2 if axis == 'X' else 1.0)
    shapes = []
    for side in ('before', 'after'):
        for k in range(6):
            six = np.zeros((len(q), 6))
            for i, x in enumerate(q[:, own]):
                d = np.eye(6)[k]
                six[i] = d if side == 'before' else _carried(machine, axis, x, d)
            shapes.append(six.ravel())
    assert np.linalg.matrix_rank(np.array(shapes), tol=1e-9) == modes


def _carried(machine, axis, x, six):
    """Small motion after a joint as one before it: adjoint of its transform."""
    if axis == 'X':
        shift = np.array([x, 0, 0])
        return np.concatenate([six[:3] - np.cross(six[3:], shift), six[3:]])
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(x * np.array(machine.axes[axis].direction)).as_matrix()
    return np.concatenate([turn @ six[:3], turn @ six[3:]])


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


def test_first_order_is_near_the_exact_position_with_rotary_axes():
    rng = np.random.default_rng(3)
    machine = machine_of('w-C-A-b-Y-X-Z-t', rng)
    tables = constant(machine)
    motions = {
        m: replace(t, value=rng.normal(size=1) * (2e-5 if m.is_translation else 5e-5))
        for m, t in tables.motions.items()
    }
    tables = replace(tables, motions=motions)
    q = positions(machine, rng, 50)
    exact = exact_position(tables, q) - nominal_position(machine, q)
    assert np.abs(exact - displacement(tables, q)).max() < 5e-8


def test_wrong_shape_is_named():
    machine = machine_of('w-C-b-X-Y-Z-t')
    with pytest.raises(ShapeError, match=r'positions of X, Y, Z, C need shape \(n, 4\)'):
        displacement(constant(machine), np.zeros((2, 3)))

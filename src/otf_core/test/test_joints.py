# SPDX-License-Identifier: Apache-2.0
"""Kinematics with rotary axes: first order against the exact chain, gauge, signs."""

from dataclasses import replace

import numpy as np
import pytest

from otf_core.errors import ShapeError
from otf_core.model.joints import Sight, exact_position
from otf_core.model.kinematics import displacement, motion_influence, nominal_position
from otf_core.model.machine import machine_from_dict
from otf_core.model.motions import DIRECTIONS, MOTIONS
from otf_core.model.tables import ErrorTables, LocationError, MotionTable, Squareness

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
    square = {n: Squareness(size if n == name else 0.0) for n in machine.squareness}
    location = {n: LocationError(size if n == name else 0.0) for n in machine.location}
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
            up, down = (exact_position(constant(machine, s, name), sight, q) for s in (h, -h))
            found = (up - down) / (2 * h)
            expected = columns.get(name, np.zeros_like(found))
            assert np.abs(found - expected).max() < 1e-9, name
        for k in range(len(machine.axis_names)):
            step = np.eye(len(machine.axis_names))[k] * h
            change = (sight.nominal(q + step) - sight.nominal(q - step)) / (2 * h)
            assert np.abs(change - seen.velocity[:, :, k]).max() < 1e-9


@pytest.mark.parametrize('chain', ['w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-Z-X-b-Y-t'])
def test_product_of_transforms_holds_for_three_linear_axes_too(chain):
    rng = np.random.default_rng(1)
    machine = machine_of(chain)
    q = positions(machine, rng)
    seen = Sight.of_tool(machine).at(q)
    assert np.allclose(seen.position, q + machine.target_offset)
    for motion in MOTIONS:
        expected = motion_influence(machine, motion, q)
        found = seen.motions[motion.axis][:, :, DIRECTIONS.index(motion.direction)]
        assert np.abs(found - expected).max() < 1e-15


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


def test_first_order_is_near_the_exact_position():
    rng = np.random.default_rng(3)
    machine = machine_of('w-C-A-b-Y-X-Z-t', rng)
    tables = constant(machine)
    motions = {
        m: replace(t, value=rng.normal(size=1) * (2e-5 if m.is_translation else 5e-5))
        for m, t in tables.motions.items()
    }
    tables = replace(tables, motions=motions)
    q = positions(machine, rng, 50)
    exact = exact_position(tables, Sight.of_tool(machine), q) - nominal_position(machine, q)
    assert np.abs(exact - displacement(tables, q)).max() < 5e-8


def test_wrong_shape_is_named():
    machine = machine_of('w-C-b-X-Y-Z-t')
    with pytest.raises(ShapeError, match=r'positions of X, Y, Z, C need shape \(n, 4\)'):
        displacement(constant(machine), np.zeros((2, 3)))

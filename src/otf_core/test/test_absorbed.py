# SPDX-License-Identifier: Apache-2.0
"""Values that hold at one target offset only, found from the model."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.model.chain import displacement
from otf_core.model.evaluation import lattice, without_rigid_motion
from otf_core.model.machine import Chain
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.prediction.absorbed import offset_bound

HIDDEN = ('ECY', 'EAZ', 'EBZ', 'ECZ')


def at_offset(*offset, chain='w-b-X-Y-Z-t'):
    return replace(some_machine(), target_offset=np.array(offset), chain=Chain.parse(chain))


def test_a_target_along_z_puts_tilts_of_z_into_its_straightness_and_squareness():
    found = offset_bound(at_offset(0.0, 0.0, -0.15), HIDDEN)
    assert found.contains == {
        'B0Z': ('EBZ',), 'A0Z': ('EAZ',), 'EXZ': ('EBZ',), 'EYZ': ('EAZ',),
    }  # fmt: skip
    assert found.words('A0Z') == 'at target offset (0, 0, -150) mm, contains EAZ'
    assert found.words('C0Y') == '' and found.words('EXX') == ''
    assert found.sentence.startswith(
        'measured with one target offset, (0, 0, -150) mm: B0Z, A0Z, EXZ, EYZ include EBZ'
    )


@pytest.mark.parametrize(
    ('offset', 'hidden'),
    [((0.0, 0.0, 0.0), HIDDEN), ((0.0, 0.0, -0.15), ('ECZ',)), ((0.1, 0.2, -0.15), ())],
)
def test_without_a_lever_or_an_unseen_rotation_every_value_holds_anywhere(offset, hidden):
    found = offset_bound(at_offset(*offset), hidden)
    assert found.contains == {} and found.sentence == ''


@pytest.mark.parametrize('chain', ['w-b-X-Y-Z-t', 'w-b-Z-Y-X-t'])
@pytest.mark.parametrize('rotation', ['EAZ', 'ECZ', 'EBY'])
def test_values_that_contain_a_rotation_make_up_for_it_at_that_offset(chain, rotation):
    """Least squares on tables of the values named leave nothing; without one of them they do."""
    machine = at_offset(0.02, -0.03, -0.15, chain=chain)
    names = offset_bound(machine, (rotation,)).contains
    assert names, 'an unseen rotation with a lever is in some value'
    moved, columns = lever_part(machine, rotation), {n: node_columns(machine, n) for n in names}

    def left(used):
        basis = np.concatenate([columns[n] for n in used], axis=1)
        rest = moved - basis @ np.linalg.lstsq(basis, moved, rcond=None)[0]
        return np.linalg.norm(rest) / np.linalg.norm(moved)

    assert left(names) < 1e-9
    for name in names:
        assert left([n for n in names if n != name]) > 1e-3, name


def lever_part(machine, rotation):
    """Errors of a straight and bent rotation by the target offset alone, no rigid motion."""
    grid = lattice(machine)
    s = np.linspace(0.0, 1.0, 7)
    values = {rotation: s + 0.4 * s * (1 - s)}
    there, zero = (
        displacement(tables_of(replace(machine, target_offset=offset), values), grid)
        for offset in (machine.target_offset, np.zeros(3))
    )
    return without_rigid_motion(there - zero, grid).reshape(-1)


def node_columns(machine, name):
    """Errors of every node of a value, in its gauge, no rigid motion, (3 n, k)."""
    grid = lattice(machine)
    if name in SQUARENESS:
        fields = [displacement(tables_of(machine, {}, {name: 1.0}), grid)]
    else:
        straight = name[1] in 'XYZ' and name[1] != name[2]
        kept = range(1, 6) if straight else range(1, 7)
        fields = [displacement(tables_of(machine, {name: np.eye(7)[k]}), grid) for k in kept]
    return np.stack([without_rigid_motion(f, grid).reshape(-1) for f in fields], axis=1)


def tables_of(machine, values, squareness=None):
    """Tables of seven nodes, zero but for these values."""
    motions = {}
    for m in MOTIONS:
        axis = machine.axes[m.axis]
        nodes = np.linspace(axis.min, axis.max, 7)
        motions[m] = MotionTable(nodes, values.get(m, np.zeros(7)), np.zeros(7))
    angles = {n: ScalarError((squareness or {}).get(n, 0.0)) for n in SQUARENESS}
    return ErrorTables(machine, motions, angles)

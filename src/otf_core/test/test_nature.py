# SPDX-License-Identifier: Apache-2.0
"""The independent nature: kinematics by hand, first order against the contract, noise, judging."""

import numpy as np
import pytest
from core_cells import CONTRACT_CHAINS, zero_tables
from nature import (
    NAMES,
    SQUARE,
    Cell,
    Extra,
    influences,
    judge,
    target_on_table,
    tilted,
)
from nature_tracker import coloured

OFFSET = np.array([0.02, -0.03, -0.15])


def nothing():
    return dict.fromkeys(NAMES, np.zeros_like), dict.fromkeys(SQUARE, 0.0)


def constant(value):
    return lambda q: np.full_like(q, value)


def some_points(seed=0, count=20):
    return np.random.default_rng(seed).uniform(-0.4, 0.6, (count, 3))


def test_yaw_of_one_axis_on_the_target_side_by_hand():
    curves, square = nothing()
    curves['ECX'] = constant(0.5)
    found = target_on_table('w-b-X-Y-Z-t', OFFSET, curves, square, np.array([[0.3, 0.2, -0.1]]))
    arm_x, arm_y = 0.02, 0.2 - 0.03
    by_hand = [
        0.3 + np.cos(0.5) * arm_x - np.sin(0.5) * arm_y - 0.02,
        np.sin(0.5) * arm_x + np.cos(0.5) * arm_y + 0.03,
        -0.1,
    ]
    assert found[0] == pytest.approx(by_hand, abs=1e-15)


def test_yaw_of_one_axis_on_the_table_side_turns_its_own_travel():
    curves, square = nothing()
    curves['ECX'], curves['EXX'] = constant(0.5), constant(1e-3)
    found = target_on_table('w-X-b-Y-Z-t', OFFSET, curves, square, np.array([[0.3, 0.2, -0.1]]))
    arm_x, arm_y = 0.3 + 0.02, 0.2 - 0.03
    by_hand = [
        1e-3 + np.cos(0.5) * arm_x - np.sin(0.5) * arm_y - 0.02,
        np.sin(0.5) * arm_x + np.cos(0.5) * arm_y + 0.03,
        -0.1,
    ]
    assert found[0] == pytest.approx(by_hand, abs=1e-15)


@pytest.mark.parametrize('chain', [*CONTRACT_CHAINS, 'w-Z-X-Y-b-t'])
@pytest.mark.parametrize('name', [*NAMES, *SQUARE])
def test_first_order_is_the_contract_and_the_rest_of_second_order(chain, name):
    q = some_points(1)
    rest = []
    for size in (1e-3, 1e-4):
        curves, square = nothing()
        if name in SQUARE:
            square[name] = size
        else:
            curves[name] = constant(size)
        moved = target_on_table(chain, OFFSET, curves, square, q) - q
        rest.append(np.abs(moved - size * influences(chain, OFFSET, q)[name]).max())
    assert rest[0] < 1e-6
    assert rest[1] < 0.011 * rest[0] + 1e-15


@pytest.mark.parametrize(
    ('name', 'axis', 'towards'),
    [('C0Y', 1, (-1, 0, 0)), ('B0Z', 2, (1, 0, 0)), ('A0Z', 2, (0, -1, 0))],
)
def test_squareness_tilts_the_axis_to_the_side_that_the_contract_says(name, axis, towards):
    direction = tilted(**{name.lower(): 1e-3})[axis]
    assert direction @ towards == pytest.approx(np.sin(1e-3), rel=1e-6)
    assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-15)


def test_noise_has_the_variance_and_the_colour_asked_for():
    series = coloured(np.random.default_rng(1), 400_000, 0.01, 0.6, 0.3, None)
    assert series.std() == pytest.approx(1.0, abs=0.02)
    lag = 20
    assert np.mean(series[lag:] * series[:-lag]) == pytest.approx(
        0.6 * np.exp(-0.2 / 0.3), abs=0.03
    )
    heavy = coloured(np.random.default_rng(1), 400_000, 0.01, 0.0, 0.3, 5)
    assert heavy.std() == pytest.approx(1.0, abs=0.02)
    assert np.abs(heavy).max() > 8


def test_a_recording_is_the_path_seen_from_the_tracker():
    cell = Cell(4, translation=0.0, rotation=0.0, path='short', passes=1, u_range=1e-12,
                u_angle=1e-12)  # fmt: skip
    run = cell.recording(rate=50.0)
    points = run.samples.xyz @ cell.rotation + cell.place
    assert np.abs(points[0] - cell.path.points[0]).max() < 1e-9
    assert np.abs(points[-1] - cell.path.points[-1]).max() < 1e-9
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) * 50
    assert speed.max() == pytest.approx(0.25, rel=1e-3)
    assert np.linalg.norm(np.diff(speed) * 50) > 0
    assert np.abs(np.diff(speed) * 50).max() < 4.5
    assert np.linalg.det(cell.rotation) == pytest.approx(1.0)
    ends = np.flatnonzero(np.linalg.norm(points[:, None] - cell.path.points[1], axis=2) < 1e-7)
    assert len(ends) >= 0.2 * 50 - 1


def test_effects_beside_the_rigid_machine_show_in_the_recording_only():
    plain = {'path': 'short', 'passes': 1, 'u_range': 1e-12, 'u_angle': 1e-12}
    still = Cell(5, **plain)
    extra = Extra(drift=(1e-5, 0, 0), drift_time=20.0, lag=(0, 1e-4, 0))
    moving = Cell(5, **plain, extra=extra)
    one, other = (c.recording(rate=50.0).samples.xyz @ c.rotation for c in (still, moving))
    shift = other - one
    assert shift[-1, 0] == pytest.approx(1e-5, rel=1e-2)
    assert np.abs(shift[:, 1]).max() == pytest.approx(2.5e-5, rel=0.01)
    q = still.lattice()
    assert np.array_equal(still.error(q), moving.error(q))
    wavy = Cell(5, **plain, extra=Extra(cyclic=(5e-6, 0, 0)))
    assert np.abs(wavy.error(q) - still.error(q)).max(axis=0)[0] > 3e-6


def test_judging_true_tables_leaves_nothing_and_zero_tables_everything():
    cell = Cell(6, 'w-Y-b-X-Z-t', form='polygon', path='short')
    nothing_known = zero_tables(cell.machine)
    worst = judge(cell, nothing_known)
    assert worst.left_percent == pytest.approx(100.0)
    motions = {
        n: type(t)(cell.curves[n].position, cell.curves[n].value, 0 * cell.curves[n].value)
        for n, t in nothing_known.motions.items()
    }
    square = {n: type(s)(cell.square[n]) for n, s in nothing_known.squareness.items()}
    true = type(nothing_known)(cell.machine, motions, square)
    assert judge(cell, true).left_percent < 0.1
    count = 3 + sum(len(m.value) for m in motions.values())
    found = judge(cell, true, 1e-12 * np.eye(count))
    assert found.within_2u_percent == 100.0

# SPDX-License-Identifier: Apache-2.0
"""Lines that laps repeat are known as one; matrices that are made anew are those that are held."""

from dataclasses import replace

import numpy as np
from core_cells import (
    observed,
    pieces_of,
    small_plan,
    some_machine,
    transform_pose,
    white,
    zero_tables,
)

from otf_core.model.nodes import table_nodes
from otf_core.noise.noise_model import Misfit
from otf_core.pieces.pieces import OF_EACH
from otf_core.solving import whitener as whitener_module
from otf_core.solving.normal import normal_equations
from otf_core.solving.system import build_system
from otf_core.solving.unknowns import layout, linear_bases
from otf_core.solving.whitener import Whitener

LAPS = 3
OWN = ('leg', 'time', 'duration')


def laps(drop=(), backward=False):
    """Rows and whitener of some laps over the same points; their noise differs."""
    machine = some_machine()
    pose, path = transform_pose(machine, 3), small_plan(machine).path
    once = pieces_of(machine, path, zero_tables(machine), pose, size=0.03)
    place, legs = np.tile(np.arange(len(once)), LAPS), once.leg.max() + 1
    rng = np.random.default_rng(4)
    pieces = replace(
        once,
        **{name: getattr(once, name)[place] for name in OF_EACH if name not in OWN},
        leg=np.concatenate([once.leg + lap * legs for lap in range(LAPS)]),
        time=0.2 * np.arange(len(place)),
        duration=rng.uniform(0.05, 0.3, len(place)),
    )
    if backward:
        second = pieces.leg == legs
        pieces = replace(
            pieces,
            direction=np.where(second[:, None], -pieces.direction, pieces.direction),
            side=np.where(second[:, None], -pieces.side, pieces.side),
        )
    pieces = pieces.without(np.isin(np.arange(len(place)), drop))
    unknowns = layout(linear_bases(machine, table_nodes(machine, machine.lower, machine.upper)), 1)
    system = build_system(observed(machine, pieces, pose), unknowns)
    deviation = 1e-5 * rng.standard_normal(system.deviation.shape)
    whitener = Whitener.of(system, pieces, white(machine), Misfit(4e-7, 9e-7))
    return replace(system, deviation=deviation), unknowns, whitener, legs, pieces


def ways(system, pieces, whitener):
    """From where to where every leg is driven, which way, and from which side its axes came."""
    rows = np.hstack([system.q, pieces.direction, pieces.side]).round(9) + 0.0
    return [(*rows[low], *rows[high - 1]) for low, high in whitener.bounds]


def test_only_passes_over_the_same_pieces_in_the_same_direction_are_one_line():
    system, _, whitener, legs, pieces = laps()
    lines = whitener.line.max() + 1
    assert lines == len(set(ways(system, pieces, whitener))) <= legs
    assert laps(drop=(5,))[2].line.max() == lines
    assert laps(backward=True)[2].line.max() == lines


def test_matrices_that_are_not_held_are_those_that_are(monkeypatch):
    system, unknowns, held, *_ = laps()
    monkeypatch.setattr(whitener_module, 'MAX_BYTES_IN_MEMORY', 0.0)
    anew = laps()[2]
    assert all(isinstance(a.held, np.ndarray) for a in held.alike)
    assert not any(isinstance(a.held, np.ndarray) for a in anew.alike)
    np.testing.assert_array_equal(anew.weighted(system.deviation), held.weighted(system.deviation))
    np.testing.assert_array_equal(anew.expected, held.expected)
    a, b = normal_equations(system, unknowns, anew), normal_equations(system, unknowns, held)
    np.testing.assert_array_equal(a.matrix, b.matrix)

# SPDX-License-Identifier: Apache-2.0
"""Which functions motions are made of, on machines whose errors know nothing of tables."""

import numpy as np
from core_cells import some_machine
from nature import LETTERS, NAMES, Cell
from nature_forms import DENSE, Curve
from standstill_points import edge_points, spread_points

from otf_core.config import OTF, STANDSTILL, CalibrationConfig
from otf_core.pieces.runs import prepare_runs
from otf_core.solving.model_choice import (
    INTERVALS,
    MIN_GAIN_OF_FINER,
    choose_shapes,
    linear_bases,
    smooth_bases,
)
from otf_core.solving.unknowns import CUBIC, LINEAR

CONFIG = CalibrationConfig(piece_length=0.015)
SIZE = (0.3, 0.25, 0.2)


def no_progress(stage, fraction):
    pass


def small(form='waves', **settings):
    return Cell(3, size=SIZE, pitch=0.05, form=form, **({'path': 'short', 'passes': 1} | settings))


def chosen(cell, method=OTF, rate=60.0):
    runs, nodes = prepare_runs([cell.recording(rate)], CONFIG, method)
    found = choose_shapes(runs, nodes, CONFIG, no_progress)
    moved = found.runs[0].pose.apply(runs[0].pieces.xyz) - runs[0].pose.apply(runs[0].pieces.xyz)
    assert 1e-7 < np.abs(moved).max() < 1e-3  # the pose of the first solution is where to go on
    return cell.machine, nodes, found


def same(bases, others):
    return all(
        bases[a].degree == others[a].degree and np.array_equal(bases[a].knots, others[a].knots)
        for a in 'XYZ'
    )


def test_smooth_motions_need_nothing_else():
    machine, nodes, found = chosen(small())
    assert found.evidence['smooth'] > -MIN_GAIN_OF_FINER
    assert found.evidence['straight between nodes'] < -100.0
    assert same(found.bases, smooth_bases(machine, nodes))
    assert {len(found.bases[a].knots) for a in 'XYZ'} == {INTERVALS + 1}
    assert {found.bases[a].degree for a in 'XYZ'} == {CUBIC}
    assert set(found.start.logs) <= set(NAMES)


def test_motions_straight_between_nodes_are_taken_as_such():
    machine, nodes, found = chosen(small('polygon'))
    assert same(found.bases, linear_bases(machine, nodes))
    assert {found.bases[a].degree for a in 'XYZ'} == {LINEAR}
    assert found.evidence['straight between nodes'] == 0.0
    assert max(v for k, v in found.evidence.items() if k != 'straight between nodes') < -10.0


def test_twelve_waves_over_an_axis_call_for_finer_splines():
    cell = small()
    s = np.linspace(0.0, 1.0, DENSE)
    for name in ('EXX', 'EZX', 'EYY', 'EXY', 'EZZ'):
        axis = cell.machine.axes[name[2]]
        phase = LETTERS.index(name[1])
        wave = 8e-6 * np.sin(2 * np.pi * 12 * s + phase)
        cell.curves[name] = Curve(axis.min + s * (axis.max - axis.min), wave)
    machine, nodes, found = chosen(cell)
    assert same(found.bases, smooth_bases(machine, nodes, 2 * INTERVALS))
    assert found.evidence['smooth'] < -100.0


def test_stops_find_smooth_motions_smooth():
    machine = some_machine()
    points = np.concatenate([edge_points(machine, 40), spread_points(machine, 60)])
    found = chosen(small(path=points, passes=1, feed=0.5, dwell=0.8), STANDSTILL)[2]
    assert max(found.evidence.values()) == 0.0
    assert found.evidence['straight between nodes'] < 0.0
    assert {b.degree for b in found.bases.values()} == {CUBIC}

# SPDX-License-Identifier: Apache-2.0
"""Curves of short chords: what counts as one, its pieces, its samples, their sagitta."""

import time
from itertools import pairwise

import numpy as np
import pytest
from nature import Cell
from programs import arc, drive, helix, record

from otf_core.config import CalibrationConfig
from otf_core.pieces.pieces import reduce_to_pieces
from otf_core.tracking.alignment import align
from otf_core.tracking.curves import (
    GROUP_LENGTH,
    MAX_TURN,
    Lines,
    largest_sagitta,
    piece_boundaries,
    shape_of,
)
from otf_core.tracking.driving_order import OFF_PATH

CONFIG = CalibrationConfig()
X, Y, Z = np.eye(3)
CELL = Cell(3, size=(0.3, 0.25, 0.2), pitch=0.05, form='polygon', path='short', passes=1)
CENTRE = 0.5 * (CELL.machine.lower + CELL.machine.upper)
NODES = tuple(np.linspace(-0.4, 0.4, 17) for _ in range(3))


def circle(chord, radius=0.09, turns=1.0, centre=CENTRE):
    return arc(centre, X, Y, radius, 0.3, 0.3 + 2 * np.pi * turns, chord)


def test_long_lines_and_sharp_corners_are_legs_of_their_own():
    points = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0.005, 0], [0.21, 0.05, 0], [0.22, 0, 0]])
    assert shape_of(points).straight


def test_a_circle_between_lines_is_one_curve():
    path = np.concatenate([[CENTRE - 0.05 * Z], circle(1e-3), [CENTRE + 0.05 * Z]])
    shape = shape_of(path)
    assert len(np.unique(shape.stretch)) == 3
    assert np.count_nonzero(shape.curved) == len(path) - 3
    length = Lines.of(shape).total[5]
    assert length == pytest.approx(2 * np.pi * 0.09, rel=1e-4)


@pytest.mark.parametrize('radius', [0.01, 0.09, 0.5])
def test_parts_of_a_curve_turn_little_and_are_not_long(radius):
    shape = shape_of(circle(1e-3, radius))
    lines = Lines.of(shape)
    for first in np.unique(shape.group):
        own = shape.group == first
        assert lines.length[own].sum() < GROUP_LENGTH + 1e-3
        unit = lines.unit[own]
        assert np.arccos(np.clip(unit[0] @ unit[-1], -1, 1)) < 1.1


@pytest.mark.parametrize('chord', [1e-4, 1e-3, 5e-3])
def test_vertices_stay_within_the_tolerance(chord):
    shape = shape_of(helix(CENTRE, 0.05, 0.02, 3, chord))
    vertex = shape.vertices(1e-3)
    assert len(vertex) < 120  # chords of 20 mm: 47 a turn
    for a, b in pairwise(vertex):
        points = shape.corners[a : b + 1]
        way = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
        local = points - points[0]
        assert np.linalg.norm(local - np.outer(local @ way, way), axis=1).max() < 1.001e-3


def test_samples_settle_on_the_nearest_chord_of_their_passage():
    path = helix(CENTRE, 0.05, 0.02, 3)
    lines = Lines.of(shape_of(path))
    rng = np.random.default_rng(1)
    true = rng.integers(0, len(path) - 1, 500)
    points = path[true] + rng.uniform(0.2, 0.8, (500, 1)) * np.diff(path, axis=0)[true]
    points += 1e-5 * rng.standard_normal(points.shape)
    begin = np.clip(true + rng.integers(-30, 31, 500), 0, len(path) - 2)
    np.testing.assert_array_equal(lines.settled(points, begin), true)


def test_pieces_of_a_curve_end_at_nodes_and_turn_little():
    path = circle(1e-3, 0.05)
    marks = piece_boundaries(path, NODES, 0.008)
    done = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    assert np.diff(marks).max() < 0.05 * MAX_TURN * 1.05
    place = np.stack([np.interp(marks, done, path[:, k]) for k in range(3)], axis=1)
    middle = np.stack(
        [np.interp(0.5 * (marks[1:] + marks[:-1]), done, path[:, k]) for k in range(3)], axis=1
    )
    for axis in range(2):  # both ends of a piece lie in the interval of its middle
        interval = np.searchsorted(NODES[axis], middle[:, axis])
        low, high = NODES[axis][interval - 1], NODES[axis][interval]
        for end in (place[:-1, axis], place[1:, axis]):
            assert np.all((end > low - 1e-9) & (end < high + 1e-9))


@pytest.mark.parametrize('chord', [1e-4, 1e-3, 5e-3])
def test_pieces_of_a_perfect_machine_lie_on_the_curve(chord):
    cell = Cell(3, size=(0.3, 0.25, 0.2), pitch=0.05, form='polygon', path='short', passes=1,
                translation=1e-15, rotation=1e-15, u_range=1e-12, u_angle=1e-12)  # fmt: skip
    path = np.concatenate(
        [cell.path.points, circle(chord), circle(chord, centre=CENTRE + 0.03 * Z)]
    )
    recording = record(cell, drive(path, 0.15, rate=200.0), path)
    found = align(recording.samples, recording.path, CONFIG)
    pieces = reduce_to_pieces(recording.samples, found, NODES, CONFIG)
    local = found.T_machine_tracker.apply(pieces.xyz) - pieces.origin
    along = np.einsum('ij,ij->i', local, pieces.direction)
    beside = np.linalg.norm(local - along[:, None] * pieces.direction, axis=1)
    assert np.count_nonzero(pieces.stretch != pieces.leg) > 80
    assert beside.max() < 2e-8  # 1/1000 of the sagitta of a piece, and of the fine alignment
    assert np.all(np.diff(pieces.time) > 0)


@pytest.mark.parametrize(('chord', 'said'), [(1e-3, False), (5e-3, True)])
def test_coarse_chords_are_said_with_their_sagitta(chord, said):
    path = np.concatenate([CELL.path.points, circle(chord)])
    recording = record(CELL, drive(path, 0.15, rate=50.0), path, rate=50.0)
    found = align(recording.samples, recording.path, CONFIG)
    sagitta = largest_sagitta(Lines.of(found.shape))
    assert sagitta == pytest.approx(chord**2 / 8 / 0.09, rel=0.02)
    assert ('publish chords of 1 mm or less' in ' '.join(found.remarks)) == said


def test_twenty_thousand_chords_align_in_seconds():
    rings = [circle(1e-3, 0.1, 6.0, CENTRE + level * Z) for level in (-0.06, -0.02, 0.02, 0.06)]
    path = np.concatenate([CELL.path.points, *rings])
    path = np.concatenate([path, *(circle(1e-3, r, 3.0) for r in (0.08, 0.06, 0.04))])
    assert len(path) > 18_000
    recording = record(CELL, drive(path, 0.3, rate=50.0), path, rate=50.0)
    start = time.process_time()
    found = align(recording.samples, recording.path, CONFIG)
    assert time.process_time() - start < 8.0
    assert found.coverage > 0.97
    assert np.mean(found.leg != OFF_PATH) > 0.9

# SPDX-License-Identifier: Apache-2.0
"""Calibration of machines with rotary axes: bags, matching, gauge, tables, contradictions."""

import json
from dataclasses import replace

import numpy as np
import pytest
from rotary_cells import machine, plan_of, recorded, truth

from otf_core.bags.bag import BagContent, write_bag
from otf_core.bags.cdr import encode_axes
from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError, InputError
from otf_core.inputs.path_file import read_path, read_plan
from otf_core.inputs.recordings import ReadingOptions, read_recording
from otf_core.model.axis_path import (
    TURN_RATE,
    AxisPath,
    driven_length,
)
from otf_core.model.chain import Sight, displacement
from otf_core.model.evaluation import evenly_spread
from otf_core.model.motions import ErrorMotion
from otf_core.pieces.pieces import LEAST_CHORD
from otf_core.prediction.predict import predict
from otf_core.sim.drive import drives_of
from otf_core.solving.tabulate import field_rows, gauge_matrix, projection
from otf_core.solving.unknowns import over_turn
from otf_core.tracking.curve_matching import match, nominal_places, sight_at, split_parts
from otf_core.tracking.curves import NO_PART, Lines, PathShape, shape_of_parts
from otf_core.tracking.mismatch import check_matched


def test_trajectory_is_what_rosbags_reads():
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    data = encode_axes(('C', 'X'), np.array([[0.5, 0.1], [1.5, 0.2]]), 7, 'tool')
    message = store.deserialize_cdr(data, 'trajectory_msgs/msg/JointTrajectory')
    assert message.header.frame_id == 'tool' and message.joint_names == ['C', 'X']
    assert [p.positions.tolist() for p in message.points] == [[0.5, 0.1], [1.5, 0.2]]


def test_bag_with_axis_positions_survives_writing(tmp_path):
    recording = recorded()
    parts = recording.parts
    write_bag(tmp_path / 'bag', BagContent(recording.samples, recording.path))
    again = read_recording([tmp_path / 'bag'], machine())
    assert [p.target for p in again.parts] == [p.target for p in parts]
    for one, other in zip(again.parts, parts, strict=True):
        assert np.array_equal(one.positions, other.positions)
    assert np.array_equal(again.samples.xyz, recording.samples.xyz)


def test_a_text_of_samples_takes_its_parts_from_a_file(tmp_path):
    recording = recorded()
    rows = np.column_stack([recording.samples.time, recording.samples.xyz])[:400]
    np.savetxt(tmp_path / 's.csv', rows, '%.9f', ',', header='time_s,x_m,y_m,z_m', comments='')
    parts, axes = recording.parts, list(machine().axis_names)
    lines = [f'target,{",".join(axes).lower()}']
    lines += [f'{p.target},{",".join(map(repr, q))}' for p in parts for q in p.positions.tolist()]
    (tmp_path / 'path.csv').write_text('\n'.join(lines))
    plan = [{'target': p.target, 'positions': p.positions.tolist()} for p in parts]
    content = {'schema': 'otf-plan/2', 'axes': axes, 'parts': plan}
    (tmp_path / 'plan.json').write_text(json.dumps(content))
    with pytest.raises(ConfigError, match=r'parts: entry 0: feed: missing'):
        read_plan(tmp_path / 'plan.json')  # drawn by hand: a path, but no plan
    for part in plan:
        count = len(part['positions'])
        part |= {'feed': (count - 1) * [0.1], 'dwell': count * [0.0]}
    content['assumed'] = {'tracker_link': 'b', 'tracker_place': [0, 0, 0]}
    (tmp_path / 'plan.json').write_text(json.dumps(content))
    for file in ('path.csv', 'plan.json'):
        again = read_recording(
            [tmp_path / 's.csv'], machine(), ReadingOptions(path=tmp_path / file)
        )
        assert [p.target for p in again.parts] == [p.target for p in parts]
        for one, other in zip(again.parts, parts, strict=True):
            assert np.array_equal(one.positions, other.positions)
        with pytest.raises(ConfigError, match='rotary'):
            read_path(tmp_path / file)
    with pytest.raises(InputError, match=r'without a path; .* target,x,y,z,a,c'):
        read_recording([tmp_path / 's.csv'], machine())
    (tmp_path / 'linear.csv').write_text('x,y,z\n0,0,0.2\n0.1,0,0.2\n')
    with pytest.raises(InputError, match=r'--path'):
        options = ReadingOptions(path=tmp_path / 'linear.csv')
        read_recording([tmp_path / 's.csv'], machine(), options)


def test_positions_in_degrees_are_named():
    q = recorded().parts[2].positions.copy()
    q[:, 3:] = np.degrees(q[:, 3:])
    with pytest.raises(InputError, match=r'axis A .*degrees'):
        AxisPath(machine().axis_names, q).of(machine())
    q[:, 3] = 0.0
    with pytest.raises(InputError, match=r'axis C .*degrees'):
        AxisPath(machine().axis_names, q).of(machine())


def test_periodic_functions_repeat_and_hold_constants():
    basis = over_turn(0.0, 12)
    q = np.linspace(0, 2 * np.pi, 50)
    assert np.allclose(basis.matrix(q), basis.matrix(q + 2 * np.pi))
    assert np.allclose(basis.matrix(q).sum(axis=1), 1.0)
    wave = np.sin(basis.centres)
    assert np.abs(basis.matrix(q) @ (basis.from_values @ wave) - np.sin(q)).max() < 1e-3

    nodes = np.array([0.0, 1.0, 2.5, 4.0, 2.0 * np.pi])
    straight, values = basis.linear_between(nodes), np.array([1.0, -2.0, 3.0, 0.5])
    between = np.interp(q, nodes, np.append(values, values[0]))
    assert np.allclose(straight.matrix(q) @ values, between)
    table = projection(ErrorMotion.of('EXC'), basis, nodes) @ wave
    assert table[0] == table[-1]


def test_gauge_changes_no_error_and_makes_motions_zero_at_zero():
    tables, m = truth(), machine()
    nodes = {a: tables.motions[f'E{a}{a}'].position for a in m.axis_names}
    motions = [tables.motions[k] for k in m.motions]
    own = [t.value - t.at(np.zeros(1)) for t in motions]  # as the unknowns: zero at zero
    value = np.concatenate([[tables.scalar(n) for n in m.scalars], *own])
    matrix = gauge_matrix(m, nodes)
    again = matrix @ value
    assert np.abs(matrix @ again - again).max() < 1e-12  # a gauge is a projection
    q = evenly_spread(m.lower, m.upper, 200)
    # straight lines between nodes stand for sine and cosine of the line
    change = field_rows(m, nodes, q) @ (again - value)
    assert np.abs(change).max() < 0.1 * np.abs(field_rows(m, nodes, q) @ value).max()
    at = len(m.scalars) + sum(len(nodes[k.axis]) for k in m.motions[: m.motions.index('EXC')])
    assert abs(again[at]) < 1e-15


def test_drive_passes_all_corners_and_keeps_to_the_legs():
    q = np.array([[0.0, 0, 0, 0, 0], [0.1, 0, 0, 0, 0], [0.1, 0, 0, 1.0, 2.0]])
    plan = plan_of([AxisPath(tuple('XYZAC'), q)], feed=0.05, dwell=0.5)
    (drive,) = drives_of(machine(), plan, 2.0)
    at = drive.at(np.linspace(0, drive.duration, 2000))
    assert np.allclose(at[0], q[0]) and np.allclose(at[-1], q[-1])
    assert np.abs(at[:, 3] - 0.5 * at[:, 4]).max() < 1e-12
    assert np.abs(np.diff(at[:, 4])).max() < TURN_RATE * drive.duration / 2000 * 1.01
    dwell = PlannerConfig.end_dwell
    ends = np.array([dwell, drive.duration - dwell])
    assert np.array_equal(drive.at(ends), q[[0, -1]])
    assert np.abs(drive.at(ends + np.array([0.1, -0.1])) - q[[0, -1]]).max(axis=1).min() > 1e-3


def test_a_curve_that_turns_back_has_a_short_chord():
    along = np.linspace(0.0, 1.0, 201)
    there = 0.02 * np.abs(along - 0.5)
    corners = np.stack([there, 1e-5 * along, 0.0 * along], axis=1)
    one = np.zeros(200, dtype=np.int64)
    lines = Lines.of(PathShape(corners, one, one))
    chord = np.array([20, 100, 180])
    share = lines.closest(corners[chord], chord, np.zeros(3))[3]
    assert np.all(share[[0, 2]] > LEAST_CHORD) and share[1] < 0.1


def test_chords_stand_for_curves_and_lines_are_one_chord():
    m, places = machine(), nominal_places(machine())
    parts = recorded().parts[1:3]
    sights = [sight_at(m, p.target, places) for p in parts]
    shape = shape_of_parts(sights, [p.positions for p in parts])
    lines, first = Lines.of(shape), int(np.flatnonzero(shape.part == 1)[0])
    assert np.all(np.bincount(shape.part[shape.part >= 0]) == [16, len(shape.part) - first])
    assert not shape.curved[:17].any() and shape.curved[first:].all()
    assert shape.part[16] == NO_PART and len(np.unique(shape.stretch[first:])) == 12
    at = np.full(len(shape.part) - first, 0.5) * lines.length[first:]
    q = lines.interpolated(shape.positions, np.arange(first, len(shape.part)), at)
    middle = lines.at(at, np.arange(first, len(shape.part)))
    assert np.linalg.norm(sights[1].nominal(q) - middle, axis=1).max() < 5e-6
    travel = shape.travel[first:].sum()
    assert travel == pytest.approx(driven_length(m, parts[1].positions))


def test_parts_are_told_apart_by_the_broken_beam():
    recording = recorded()
    parts = split_parts(recording.samples, machine(), recording.parts)
    assert [p.path.target for p in parts] == ['tool', 'long', 'nest-1', 'nest-2', 'nest-3']
    assert parts[0].first == 0 and parts[-1].last == len(recording.samples)
    with pytest.raises(InputError, match=r'6 parts'):
        first = recording.parts[0]
        longer = replace(first, positions=np.concatenate([first.positions, first.positions]))
        six = [longer.of(machine()), *recording.parts]
        split_parts(recording.samples, machine(), six)


def test_a_recording_that_ended_early_holds_the_first_parts():
    recording = recorded()
    third = split_parts(recording.samples, machine(), recording.parts)[2]
    end = third.first + (third.last - third.first) // 2
    matched = match(recording.samples.part(0, end), machine(), recording.parts)
    assert [p.path.target for p in matched.parts] == ['tool', 'long', 'nest-1']
    assert [p.target for p in matched.missing] == ['nest-2', 'nest-3']
    assert 0.3 < matched.parts[2].driven < 0.7
    assert max(part.distance for part in matched.parts) < 1e-4
    (note,) = check_matched(recording.samples, matched, recording.parts)
    assert note.endswith('not recorded: nest-2, nest-3')
    far = replace(matched, location={**matched.location, 'Z0A': 0.1})
    with pytest.raises(InputError, match=r'axes: A: centre: .* it fits \['):
        check_matched(recording.samples, far, recording.parts)


def test_tables_predict_the_exact_error_within_second_order():
    from otf_core.model.chain import exact_position

    tables = truth().scaled(1.5)
    q = evenly_spread(machine().lower, machine().upper, 100)
    sight = Sight.of_tool(machine())
    exact = exact_position(tables, q, sight) - sight.nominal(q)
    assert np.abs(exact - displacement(tables, q)).max() < 5e-8
    from otf_core.prediction.calibration_document import CalibrationDocument

    found = predict(CalibrationDocument.of_tables(tables), q)
    assert np.array_equal(found.error, displacement(tables, q))

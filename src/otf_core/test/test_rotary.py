# SPDX-License-Identifier: Apache-2.0
"""Calibration of machines with rotary axes: bags, matching, gauge, tables, contradictions."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from otf_core.bags.bag import BagContent, write_bag
from otf_core.bags.cdr import decode_axes, encode_axes
from otf_core.cli import main
from otf_core.config import CalibrationConfig, SimulationConfig
from otf_core.errors import InputError
from otf_core.inputs.recordings import read_recording
from otf_core.live.stages import silent
from otf_core.model.axis_path import AxisPath, along_legs, nominal_track, position_at
from otf_core.model.joints import Sight
from otf_core.model.kinematics import displacement
from otf_core.model.machine import load_machine
from otf_core.model.tables import load_tables
from otf_core.pieces.runs import Recording
from otf_core.prediction.predict import predict
from otf_core.prediction.uncertainty import prediction_uncertainty
from otf_core.rotary.calibrate import calibrate_axes
from otf_core.rotary.matching import match, split_parts
from otf_core.rotary.periodic import over_turn
from otf_core.rotary.tabulation import evenly_spread, field_rows, gauge_matrix, without_rigid
from otf_core.sim.axis_cell import JointDrive, simulate_parts, usual_parts

BAG = Path(__file__).parents[3] / 'bags' / 'trunnion'


@cache
def machine():
    return load_machine(BAG / 'machine.yaml')


@cache
def recorded():
    return read_recording([BAG / 'bag'], machine())


@cache
def calibrated():
    return calibrate_axes([recorded()], CalibrationConfig(), silent)


def truth():
    return load_tables(BAG / 'truth.json').tables


def left(found, true, q):
    """Share of the errors at positions that tables leave, rigid motion of the table taken out."""
    e = displacement(true, q)
    d = displacement(found, q) - e
    rms = [
        float(np.sqrt(np.mean(without_rigid(true.machine, q, v.reshape(-1, 1)) ** 2)))
        for v in (d, e)
    ]
    return rms[0] / rms[1]


def test_trajectory_survives_its_encoding():
    q = np.array([[0.1, -0.2, 0.0, 0.5, 6.0], [0.2, 0.1, 0.3, -0.5, 0.0]])
    data = encode_axes(('X', 'Y', 'Z', 'A', 'C'), q, 5, 'nest-1')
    frame, names, positions = decode_axes(data)
    assert (frame, names) == ('nest-1', ('X', 'Y', 'Z', 'A', 'C'))
    assert np.array_equal(positions, q)
    with pytest.raises(InputError, match='no trajectory_msgs/msg/JointTrajectory'):
        decode_axes(data[:-9])


def test_trajectory_is_what_rosbags_reads():
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    data = encode_axes(('C', 'X'), np.array([[0.5, 0.1], [1.5, 0.2]]), 7, 'tool')
    message = store.deserialize_cdr(data, 'trajectory_msgs/msg/JointTrajectory')
    assert message.header.frame_id == 'tool' and message.joint_names == ['C', 'X']
    assert [p.positions.tolist() for p in message.points] == [[0.5, 0.1], [1.5, 0.2]]


def test_bag_with_axis_positions_survives_writing(tmp_path):
    recording = recorded()
    parts = recording.axis_paths
    write_bag(tmp_path / 'bag', BagContent(recording.samples, None, axis_paths=parts))
    again = read_recording([tmp_path / 'bag'], machine())
    assert [p.target for p in again.axis_paths] == [p.target for p in parts]
    for one, other in zip(again.axis_paths, parts, strict=True):
        assert np.array_equal(one.positions, other.positions)
    assert np.array_equal(again.samples.xyz, recording.samples.xyz)


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'axes': ('X', 'Y', 'Z', 'A', 'B')}, 'axis positions are of X, Y, Z, A, B, the machine'),
        ({'target': 'nest-9'}, "target 'nest-9' is not among the targets"),
    ],
)
def test_part_of_another_machine_is_refused(change, words):
    with pytest.raises(InputError, match=words):
        replace(recorded().axis_paths[0], **change).of(machine())


def test_positions_in_degrees_are_named():
    q = recorded().axis_paths[2].positions.copy()
    q[:, 3:] = np.degrees(q[:, 3:])
    with pytest.raises(InputError, match=r'axis A by .* rad; is it in degrees'):
        AxisPath(machine().axis_names, q).of(machine())
    q[:, 3] = 0.0
    with pytest.raises(InputError, match=r'axis C turns up to .*; is it in degrees'):
        AxisPath(machine().axis_names, q).of(machine())


def test_places_on_legs_hold_all_corners():
    q = np.array([[0.0, 0, 0, 0, 0], [0.1, 0, 0, 0, 0], [0.1, 0, 0, 0, 3.0]])
    place = along_legs(q, 0.01, 0.1)
    assert {0.0, 1.0, 2.0} <= set(place.tolist()) and len(place) == 41
    assert np.allclose(position_at(q, np.array([1.5])), [[0.1, 0, 0, 0, 1.5]])
    assert len(nominal_track(machine(), recorded().axis_paths).points) > 1000


def test_periodic_functions_repeat_and_hold_constants():
    basis = over_turn(0.0, 12)
    q = np.linspace(0, 2 * np.pi, 50)
    assert np.allclose(basis.matrix(q), basis.matrix(q + 2 * np.pi))
    assert np.allclose(basis.matrix(q).sum(axis=1), 1.0)
    wave = np.sin(basis.centres)
    assert np.abs(basis.matrix(q) @ (basis.from_values @ wave) - np.sin(q)).max() < 1e-3


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
    drive = JointDrive(machine(), q, 0.05, 2.0, 0.5)
    at = drive.at(np.linspace(0, drive.duration, 2000))
    assert np.allclose(at[0], q[0]) and np.allclose(at[-1], q[-1])
    assert np.abs(at[:, 3] - 0.5 * at[:, 4]).max() < 1e-12
    assert np.abs(np.diff(at[:, 4])).max() < 0.05 / 0.2 * drive.duration / 2000 * 1.01


def test_parts_are_told_apart_by_the_broken_beam():
    recording = recorded()
    parts = split_parts(recording.samples, machine(), recording.axis_paths)
    assert [p.path.target for p in parts] == ['tool', 'long', 'nest-1', 'nest-2', 'nest-3']
    assert parts[0].first == 0 and parts[-1].last == len(recording.samples)
    with pytest.raises(InputError, match=r'6 parts were published .* only 4 times'):
        six = [*recording.axis_paths, recording.axis_paths[0]]
        split_parts(recording.samples, machine(), six)


def test_recorded_trunnion_comes_out_as_it_is():
    result, true = calibrated(), truth()
    q = evenly_spread(machine().lower, machine().upper, 800)
    assert left(result.tables, true, q) < 0.10
    assert set(result.made.hidden) == {'ECX', 'ECZ'}
    assert all('spindle axis' in result.advice[n] for n in result.made.hidden)
    assert not result.failed_gates and result.fit.inflation < 1.2
    d = displacement(result.tables, q) - displacement(true, q)
    away = without_rigid(machine(), q, d.reshape(-1, 1)).reshape(-1, 3)
    u = predict_u(result, q)
    assert np.mean(np.abs(away) < 2 * u) > 0.88
    assert np.sqrt(np.mean((away / u) ** 2)) > 0.35


def test_places_of_reflectors_and_tracker_are_found():
    data = json.loads((BAG / 'truth.json').read_text())
    for name, (place, u) in calibrated().targets.items():
        off = np.abs(place - np.array(data['targets'][name]['place']))
        known = machine().targets[name].u == 0.0
        assert np.all(off <= 2e-5), name  # the truth has its own gauge
        assert known == (not u.any())
    pose = calibrated().solution.poses[0]
    assert np.abs(pose.translation - np.array(data['alignment']['translation'])).max() < 5e-5


def predict_u(result, q):
    """Standard uncertainty of the predicted errors."""
    m, tables = machine(), result.tables
    nodes = {k: tables.motions[k].position for k in m.motions}
    return prediction_uncertainty(m, nodes, result.made.covariance, q)


@cache
def circles_only(tilted):
    """Lines with the tool; circles of C and arcs of A on three places, never both at once."""
    m, parts = machine(), []
    for part in usual_parts(machine()):
        q = part.positions
        if part.target.startswith('nest'):
            a = (0.5, 1.2) if tilted else (0.0,)
            rows = [[0, 0, 0, a[0], 0]]
            for angle in a:
                rows += [[0, 0, 0, angle, c] for c in (0, 2 * np.pi, 0)]
            rows += [[0, 0, 0, x, 0] for x in (-0.5, 1.6, -0.5)]
            q = np.array(rows, dtype=float)
        parts.append(AxisPath(m.axis_names, q, part.target))
    config = SimulationConfig(seed=11, rate=40.0)
    run = simulate_parts(m, parts, config, feed=0.1, dwell=0.1)
    recording = Recording(
        run.samples, nominal_track(m, run.parts), m, 'circles', axis_paths=run.parts
    )
    return calibrate_axes([recording], CalibrationConfig(), silent)


def test_circles_alone_do_not_show_the_angular_positioning():
    result = circles_only(False)
    assert {'ECC', 'EAA'} <= set(result.made.hidden)
    assert not {'EXC', 'EYC', 'EZC', 'EAC', 'EBC', 'X0C', 'Y0C', 'A0C'} & set(result.made.hidden)
    assert not result.tables.motions['ECC'].value.any()
    assert 'together in both senses' in result.advice['ECC']


def test_circles_at_a_tilted_table_leave_the_zero_of_the_tilting_axis_open():
    result = circles_only(True)
    assert {'ECC', 'EAA', 'A0C'} <= set(result.made.hidden)
    assert 'EXC' not in result.made.hidden
    assert not result.tables.location['A0C'].identifiable


def test_axis_that_turns_the_other_way_is_named_with_the_sign_that_fits():
    m = machine()
    axes = {**m.axes, 'C': replace(m.axes['C'], direction=(0.0, 0.0, -1.0))}
    recording = replace(recorded(), machine=replace(m, axes=axes))
    words = r'fits where C turns the other way; write C: direction: \[0.0, 0.0, 1.0\]'
    with pytest.raises(InputError, match=words):
        calibrate_axes([recording], CalibrationConfig(), silent)


def test_centre_that_is_wrong_by_more_than_a_millimetre_fails_the_gate():
    m = machine()
    axes = {**m.axes, 'A': replace(m.axes['A'], centre=(0.0, 0.0, 0.023))}
    recording = replace(recorded(), machine=replace(m, axes=axes))
    result = calibrate_axes([recording], CalibrationConfig(), silent)
    assert result.exit_code == 4
    assert 'axes: A: centre' in result.failed_gates[0] and '0.01999] m' in result.failed_gates[0]


def test_places_off_by_ten_millimetres_still_converge():
    m = machine()
    targets = {
        n: replace(t, place=(t.place[0] + 0.006, t.place[1] - 0.006, t.place[2] + 0.005))
        if t.link == 'w'
        else t
        for n, t in m.stated_targets.items()
    }
    off = replace(m, stated_targets=targets)
    found = match(recorded().samples, off, recorded().axis_paths)
    for name in ('nest-1', 'nest-2', 'nest-3'):
        assert np.abs(found.places[name] - calibrated().targets[name][0]).max() < 1e-4


def test_command_line_from_simulation_to_prediction(tmp_path, capsys):
    folder, out = tmp_path / 'bag', tmp_path / 'out'
    yaml = str(BAG / 'machine.yaml')
    options = ['--rate', '25', '--feed', '9000', '--corner-dwell', '0.1', '--seed', '3']
    assert main(['simulate', '--machine', yaml, '--out', str(folder), *options]) == 0
    assert main(['calibrate', str(folder), '--machine', yaml, '--out', str(out)]) == 0
    data = json.loads((out / 'error_tables.json').read_text())
    assert data['schema'] == 'otf-error-tables/2'
    assert data['motions']['ECC']['position_unit'] == 'rad'
    assert set(data['location']) == set(machine().location)
    assert data['targets']['nest-1']['u'][0] > 0 and 'gauge' in data
    points, errors = tmp_path / 'p.csv', tmp_path / 'e.csv'
    points.write_text('x,y,z,a,c\n0,0,0.1,0.5,3.0\n0.05,0.02,0.2,-0.3,9.0\n')
    words = ['--tables', str(out / 'error_tables.json'), '--points', str(points)]
    assert main(['predict', *words, '--out', str(errors)]) == 0
    rows = np.genfromtxt(errors, delimiter=',', names=True)
    assert list(rows.dtype.names[:5]) == ['x', 'y', 'z', 'a', 'c']
    assert rows['inside'].tolist() == [1.0, 1.0] and np.all(rows['u_dx'] > 0)
    assert main(['info', str(out / 'error_tables.json')]) == 0
    assert 'small-trunnion' in capsys.readouterr().out
    points.write_text('x,y,z\n0,0,0.1\n')
    assert main(['predict', *words, '--out', str(errors), '--overwrite']) == 2
    assert 'expected x,y,z,a,c' in capsys.readouterr().err
    page = (out / 'report.html').read_text()
    assert 'average line of C' in page and 'Radial motion of C' in page


def test_tables_predict_the_exact_error_within_second_order():
    from otf_core.model.joints import exact_position

    tables = truth().scaled(1.5)
    q = evenly_spread(machine().lower, machine().upper, 100)
    sight = Sight.of_tool(machine())
    exact = exact_position(tables, sight, q) - sight.nominal(q)
    assert np.abs(exact - displacement(tables, q)).max() < 5e-8
    from otf_core.model.tables import TablesFile

    assert np.array_equal(predict(TablesFile(tables), q).error, displacement(tables, q))


@pytest.mark.parametrize('verb', ['diagnose', 'check'])
def test_commands_for_linear_axes_say_so(verb, tmp_path, capsys):
    yaml = str(BAG / 'machine.yaml')
    words = {
        'diagnose': [str(BAG / 'bag'), '--machine', yaml, '--out', str(tmp_path / 'x')],
        'check': [str(BAG / 'bag'), '--machine', yaml],
    }
    assert main([verb, *words[verb]]) == 2
    assert 'not available for machines with rotary axes' in capsys.readouterr().err


def simulated(parts, seed=12, **options):
    """A simulated recording of the small trunnion."""
    m = machine()
    run = simulate_parts(m, parts, SimulationConfig(seed=seed, rate=40.0), dwell=0.1, **options)
    path = nominal_track(m, run.parts)
    return Recording(run.samples, path, m, 'simulated', axis_paths=run.parts), run


def test_lag_of_an_axis_is_reversal_and_leaves_the_tables_alone():
    recording, run = simulated(usual_parts(machine()), feed=0.1, lag={'C': 5e-5})
    result = calibrate_axes([recording], CalibrationConfig(), silent)
    found = {r.motion: r for r in result.reversal}
    # C late against A is A ahead of C: together they drive at one ratio
    assert {'ECC', 'EAA'} & set(found)
    q = evenly_spread(machine().lower, machine().upper, 400)
    assert left(result.tables, run.truth, q) < 0.2


def test_reflector_that_was_reseated_is_named():
    parts = list(usual_parts(machine()))
    recording, run = simulated([*parts, parts[2]], feed=0.1)
    samples = recording.samples
    last = int(np.flatnonzero(np.diff(samples.stamp_ns) > 1.9e9)[-1]) + 1
    xyz = samples.xyz.copy()
    own = run.parts[-1].positions
    moved = {}
    for shift in (0.0, 6e-5):
        place = run.places['nest-1'] + shift
        sight = Sight(machine(), 'b', 'w', place)
        time = samples.time[last:] - samples.time[last]
        q = JointDrive(machine(), own, 0.1, 2.0, 0.1).at(time)
        moved[shift] = sight.nominal(q) @ run.rotation.T
    xyz[last:] += moved[6e-5] - moved[0.0]
    other = replace(recording, samples=replace(samples, xyz=xyz))
    result = calibrate_axes([other], CalibrationConfig(), silent)
    assert any("target 'nest-1': in part 6 it lies 10" in w for w in result.failed_gates)
    good = calibrate_axes([recording], CalibrationConfig(), silent)
    assert not good.failed_gates

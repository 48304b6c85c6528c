# SPDX-License-Identifier: Apache-2.0
"""The round on a control: with LinuxCNC where it is installed, else with a stand-in for it."""

import json
import re
import shutil
import sys
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from cli_cells import run
from core_cells import some_machine
from test_rotary_exports import location_only

from otf_core.bags.bag import read_bag
from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError, InputError
from otf_core.exports import export_format
from otf_core.exports.format import Request
from otf_core.exports.pivot import trunnion_pins
from otf_core.loop import circle, control, trunnion
from otf_core.loop import control as files
from otf_core.loop.circle import (
    check_plan,
    commanded_positions,
    correct_points,
    corrected_program,
    cut_legs,
)
from otf_core.model.kinematics import displacement, exact_position
from otf_core.model.machine import machine_from_dict
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan
from otf_core.model.tables import TablesFile, load_tables
from otf_core.planning.axis_programs import on_axis_increment
from otf_core.planning.nc import DIALECTS
from otf_core.planning.nc.programs import program, round_to_increment
from otf_core.planning.rotary_paths import plan_parts
from otf_core.reports.loop import write_trunnion_loop
from otf_core.sim.cell import random_tables
from otf_core.sim.drive import Drive

ACCELERATION = 5.0
installed = pytest.mark.skipif(
    shutil.which('linuxcnc') is None, reason='LinuxCNC is not installed'
)


@pytest.fixture(scope='module')
def tables():
    return random_tables(some_machine(pitch=0.04), 5e-5, np.random.default_rng(21))


def moves_of(text):
    """Points (m), feeds (m/s) and dwells (s) of a LinuxCNC program after its M0."""
    points, feeds, dwells = [], [], []
    body = text.partition('M0\n')
    last = re.findall(r'[XYZ](-?[\d.]+)', body[0].split('LOCK')[0])[-3:]
    start = {'X': last[0], 'Y': last[1], 'Z': last[2]}  # the approach ends X, Y, then Z
    points.append([float(start[a]) for a in 'XYZ'])
    dwells.append(0.0)
    for line in body[2].splitlines():
        if line.startswith('G53 G1'):
            points.append([float(v) for v in re.findall(r'[XYZ](-?[\d.]+)', line)])
            feeds.append(float(re.search(r'F(\d+)', line).group(1)) / 60e3)
            dwells.append(0.0)
        elif line.startswith('G4'):
            dwells[-1] += float(line[4:])
    return Plan(NominalPath(1e-3 * np.array(points)), np.array(feeds), np.array(dwells))


def stand_in(machine, given, programs):
    """Drive as LinuxCNC does with type 0 compensation files, at 1 kHz."""
    done = []
    for item in programs:
        drive = Drive(moves_of(item.text), ACCELERATION)
        time = 1e-3 * np.arange(int(1e3 * drive.duration) + 1)
        believed = drive.position(time)
        motor = believed.copy()
        for k, letter in enumerate('xyz'):
            name = f'compensation_{letter}.comp'
            if name in given:
                assert f'COMP_FILE = {name}'.encode() in given[files.INI]
                rows = [r.split() for r in given[name].decode().splitlines() if r[0] != '#']
                nominal, actual, _ = 1e-3 * np.array(rows, float).T
                motor[:, k] += np.interp(believed[:, k], nominal, nominal - actual)
        done.append(control.DrivenProgram(time, motor, believed, np.zeros_like(motor), 0))
    return done


def test_a_round_leaves_what_the_export_forecast_and_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(circle, 'drive', stand_in)
    monkeypatch.setattr(control, 'find_control', lambda: 'linuxcnc')
    machine = tmp_path / 'machine.yaml'
    machine.write_text(yaml.safe_dump(some_machine(pitch=0.1).to_dict()))
    out = tmp_path / 'out'
    assert run('loop', '--machine', machine, '--out', out, '--compensate', 'axes',
               '--rate', '200', '--seed', '3', '--json') == 0  # fmt: skip
    told = json.loads(capsys.readouterr().out)
    assert told['after_um'] == pytest.approx(told['forecast_um'], rel=0.05)
    assert told['after_um'] < 0.95 * told['before_um']
    # a tracker sees two of three directions
    assert told['seen_by_tracker']['after_um'] < told['seen_by_tracker']['before_um']
    assert json.loads((out / 'loop.json').read_text()).items() <= told.items()
    # the control of the stand-in brings all to the motors; what is left is of tables and format
    left = told['left_um']
    assert left['of_control'] < 0.1 * told['after_um'] < left['of_export']
    sizes = [line['after']['mean_um'] for line in told['lines']]
    lengths = [np.linalg.norm(np.subtract(v['end'], v['start'])) for v in told['lines']]
    assert np.average(sizes, weights=lengths) == pytest.approx(told['after_um'], rel=0.02)
    assert all(v['after']['mean_um'] < v['after']['largest_um'] for v in told['lines'])
    page = (out / 'loop.html').read_text()
    for clause, title in ((7, 'Determination'), (9, 'Representation'), (10, 'Application'),
                          (11, 'Validation'), (12, 'Documentation')):  # fmt: skip
        assert re.search(rf'<h2>{title}[^<]*ISO/TR 16907:2015, {clause}\)', page)
    assert '://' not in page and f'{told["after_um"]:.2f}' in page
    legs = [
        {tuple(map(tuple, np.round(sorted(map(tuple, leg)), 4))) for leg in pairwise(points)}
        for points in (read_bag(out / 'bags' / n).path.points for n in ('fit', 'check'))
    ]
    assert not legs[0] & legs[1]


def test_a_corrected_program_brings_the_target_onto_the_nominal_lines(tables):
    machine = tables.machine
    plan = round_to_increment(
        check_plan(machine, 0.3, np.random.default_rng(4)), machine.lower, machine.upper
    )
    parts = cut_legs(plan)
    moved = correct_points(parts, lambda q: displacement(tables, q))
    text = corrected_program(moved, ['test'])
    assert text.count('G64 P') == 1 and 'G61' not in text
    assert text.count('G4 P') == len(plan.path.points)  # a stop at every corner of the plan
    (driven,) = stand_in(machine, {}, [control.Program('a', text, 1.0)])
    at = commanded_positions(driven, moved.path, parts.path)
    before = displacement(tables, at.nominal)
    after = driven.motor[at.row] + displacement(tables, driven.motor[at.row]) - at.nominal
    after -= after.mean(axis=0)
    # positions of the program are whole micrometres
    assert np.sqrt(np.mean(after**2)) < 0.6e-6
    assert np.abs(after).max() < 0.05 * np.abs(before).max()


def test_a_drive_of_another_length_than_its_program_is_refused():
    points = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0]])
    believed = np.repeat(points[:2], 50, axis=0)
    driven = control.DrivenProgram(1e-3 * np.arange(100), believed, believed, 0 * believed, 0)
    with pytest.raises(InputError, match=r'drove 0\.1\d* m of a program of 0\.2'):
        commanded_positions(driven, NominalPath(points))


def test_lines_of_an_ini_piece_come_into_their_sections(tables):
    ini = files.insert_piece(
        files.ini_text(tables.machine, 5.0, 0.4), '# words\n[JOINT_1]\nCOMP_FILE = y.comp\n'
    )
    sections = re.findall(r'^\[(\w+)\]$', ini, re.M)
    assert len(sections) == len(set(sections))
    assert 'COMP_FILE = y.comp' in ini.split('[JOINT_1]')[1].split('[')[0]


def test_the_component_interpolates_the_lattice(tables, tmp_path, monkeypatch):
    from scipy.interpolate import RegularGridInterpolator

    made = export_format('lattice-csv').export(Request(TablesFile(tables), 'l.csv', points=5))
    (tmp_path / 'l.csv').write_bytes(made.files['l.csv'])
    monkeypatch.setitem(sys.modules, 'hal', SimpleNamespace())
    from otf_core.loop import offsets

    axes, table = offsets.read_lattice(tmp_path / 'l.csv')
    grid = np.empty((5, 5, 5, 3))
    for place, error in table.items():
        grid[place] = error
    q = np.random.default_rng(1).uniform(tables.machine.lower, tables.machine.upper, (20, 3))
    expected = RegularGridInterpolator(axes, grid)(q)
    np.testing.assert_allclose(
        [offsets.error_at(axes, table, list(p)) for p in q], expected, atol=1e-15
    )
    outside = offsets.error_at(axes, table, [9.0, 9.0, 9.0])
    np.testing.assert_allclose(outside, grid[-1, -1, -1])


def test_a_correction_beyond_its_limit_holds_the_feed(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'hal', SimpleNamespace())
    from otf_core.loop import offsets

    pins = {f'{kind}-{a}': 0.0 for kind in ('believed', 'offset', 'counts') for a in 'xyz'}
    pins |= {'fault': False, 'slowest': 0.0}
    axes = [[0.0, 1.0]] * 3
    table = {(i, j, k): (2e-3, 0.0, 0.0) for i in (0, 1) for j in (0, 1) for k in (0, 1)}
    offsets.look(pins, axes, table, None)
    assert pins['fault'] and pins['counts-x'] == 0.0
    assert 'feed held' in capsys.readouterr().err


def test_without_linuxcnc_the_command_says_how_to_get_it(place, monkeypatch, capsys):
    monkeypatch.setattr(shutil, 'which', lambda name: None)
    assert run('loop', '--machine', 'machine.yaml', '--out', 'out') == 2
    assert 'apt-get install -y --no-install-recommends linuxcnc-uspace' in capsys.readouterr().err
    assert not (place / 'out').exists()


def test_a_second_control_on_one_computer_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, 'which', lambda name: f'/usr/bin/{name}')
    monkeypatch.setattr(control, 'LOCK', tmp_path / 'lock')
    (tmp_path / 'lock').write_text('')
    with pytest.raises(ConfigError, match='runs on this computer already'):
        control.find_control()


@installed
@pytest.mark.xdist_group('linuxcnc')
def test_linuxcnc_corrects_by_joint_files_and_by_external_offsets(tables):
    if control.LOCK.exists():
        pytest.skip('LinuxCNC runs on this computer already')
    machine = tables.machine
    points = np.array([[0.02, 0.02, -0.02], [0.28, 0.2, -0.18], [0.15, 0.05, -0.1]])
    plan = round_to_increment(
        Plan(NominalPath(points), np.full(2, 0.3), np.full(3, 0.3)), machine.lower, machine.upper
    )
    content = TablesFile(tables)
    joints = export_format('linuxcnc').export(Request(content, 'compensation.ini'))
    volume = export_format('lattice-csv').export(Request(content, files.LATTICE))
    given = dict(joints.files)
    ini = files.insert_piece(
        files.ini_text(machine, ACCELERATION, 0.3), given.pop('compensation.ini').decode()
    )
    text = program(DIALECTS['linuxcnc'], plan, ['test'])
    (driven,) = control.drive(
        machine,
        files.written_files(machine, ini, {**given, **volume.files}, volume=True),
        [control.Program('test.ngc', text, 60.0)],
    )
    assert driven.lost == 0
    np.testing.assert_allclose(driven.believed[-1], points[-1], atol=1e-6)
    at = commanded_positions(driven, plan.path)
    by_joint = driven.motor - driven.believed - driven.offset
    np.testing.assert_allclose(by_joint, -joints.held(driven.believed + driven.offset), atol=1e-8)
    # offsets follow the position with the delay of a program in user space; at rest they are exact
    wanted = -displacement(tables, driven.believed)
    lacking = driven.offset - wanted
    still = np.flatnonzero(np.linalg.norm(np.diff(driven.believed, axis=0), axis=1) < 1e-9)
    resting = still[still > at.row[0]]
    assert np.ptp(driven.offset[at.row], axis=0).min() > 5e-6
    assert np.abs(lacking[resting] - np.median(lacking, axis=0)).max() < 5e-6
    assert np.median(np.abs(lacking[resting] - np.median(lacking, axis=0))) < 2e-7


# A trunnion: the pivot and a file per joint, judged at poses.


def trunnion_cell():
    """A trunnion whose tables turn right-handed, as LinuxCNC has them."""
    turning = {'kind': 'rotary', 'table_pitch': 0.35}
    return machine_from_dict({
        'name': 'trunnion',
        'chain': 'w-C-A-b-Y-X-Z-t',
        'axes': {
            'X': {'min': -0.15, 'max': 0.15, 'table_pitch': 0.1},
            'Y': {'min': -0.12, 'max': 0.12, 'table_pitch': 0.08},
            'Z': {'min': 0.1, 'max': 0.35, 'table_pitch': 0.125},
            'A': {**turning, 'min': -0.5, 'max': 1.5, 'direction': [-1, 0, 0],
                  'centre': [0.0, 0.03, 0.02]},
            'C': {**turning, 'min': 0.0, 'max': 6.283, 'direction': [0, 0, -1],
                  'centre': [0.01, -0.02, -0.03], 'endless': True},
        },
        'target_offset': [0.0, 0.0, -0.02],
        'tracker': {'u_range': 0.5e-6, 'u_angle': 2.0e-6, 'link': 'b'},
        'targets': {
            'long': {'link': 't', 'place': [0.0, 0.0, -0.06]},
            'nest-1': {'link': 'w', 'place': [0.12, 0.02, -0.06], 'u': 1e-3},
            'nest-2': {'link': 'w', 'place': [-0.05, 0.10, -0.08], 'u': 1e-3},
            'nest-3': {'link': 'w', 'place': [-0.04, -0.11, -0.04], 'u': 1e-3},
        },
    })  # fmt: skip


def joints_of_tip(pins, length, tip):
    """Joints (mm, degrees) for places of the tip on the table and angles, turned step by step."""
    x, y, z = tip[:, :3].T - pins['rot-point'][:, None]
    a, c = np.radians(tip[:, 3:].T)
    x, y = np.cos(c) * x - np.sin(c) * y, np.sin(c) * x + np.cos(c) * y
    y, z = y - pins['offset'][1], z - pins['offset'][2]
    y, z = np.cos(a) * y - np.sin(a) * z, np.sin(a) * y + np.cos(a) * z
    place = np.stack([x, y, z], axis=1) + pins['rot-point'] + pins['offset']
    place[:, 2] += length
    return np.column_stack([place, tip[:, 3:]])


def stand_in_trunnion(machine, given, programs):
    """Drive as LinuxCNC does, straight in what is programmed, with its trunnion kinematics."""
    hal = given[files.HAL].decode()
    pins = {
        kind: np.array([
            float(found[1]) if (found := re.search(rf'kins\.{d}-{kind} (\S+)', hal)) else 0.0
            for d in 'xyz'
        ])
        for kind in ('rot-point', 'offset')
    }  # fmt: skip
    length = float(re.search(r'Z(\S+)', given[files.TOOL_TABLE].decode())[1])
    done = []
    for item in programs:
        coupled = f'M68 E{files.KINEMATICS_OUTPUT} Q{files.COUPLED}' in item.text
        at, clock = [np.array([0, 0, -length if coupled else 0, 0, 0.0])], [0.0]
        for line in item.text.splitlines():
            if ' G1 ' in line:
                to = at[-1].copy()
                for letter, value in re.findall(r'([XYZAC])(-?[\d.]+)', line):
                    to['XYZAC'.index(letter)] = float(value)
                at.append(to)
                clock.append(clock[-1] + 60.0 / float(re.search(r'F([\d.]+)', line)[1]))
            elif line.startswith('G4 P'):
                at.append(at[-1])
                clock.append(clock[-1] + float(line[4:]))
        time = np.arange(0.0, clock[-1], 1e-3 if coupled else 1e-2)
        q = np.stack([np.interp(time, clock, v) for v in np.transpose(at)], axis=1)
        motor = believed = joints_of_tip(pins, length, q) if coupled else q
        for k, letter in enumerate('xyzac'):
            name = f'compensation_{letter}.comp'
            if name in given:
                rows = [r.split() for r in given[name].decode().splitlines() if r[0] != '#']
                nominal, actual, _ = np.array(rows, float).T
                motor = motor.copy()
                motor[:, k] += np.interp(believed[:, k], nominal, nominal - actual)
        units = files.axis_units(machine)
        done.append(control.DrivenProgram(time, motor / units, believed / units, 0.0 * motor, 0))
    return done


def test_a_round_of_a_trunnion_leaves_what_pins_and_joint_files_cannot_hold(tmp_path, monkeypatch):
    monkeypatch.setattr(trunnion, 'drive', stand_in_trunnion)
    monkeypatch.setattr(trunnion, 'trunnion_module', lambda name, conventional: None)
    machine = trunnion_cell()
    planning = PlannerConfig(passes=1, feed=0.4, levels=2)
    parts = [on_axis_increment(machine, part) for part in plan_parts(machine, planning)]
    round_ = trunnion.go_round_trunnion(
        machine, parts, 0.4, trunnion.SimulationConfig(seed=3, rate=120.0), 1e-4, str
    )
    proof = round_.proof
    assert proof.after == pytest.approx(proof.forecast, rel=0.1)
    assert proof.after < 0.5 * proof.before
    assert proof.of_control < 0.02 * proof.before
    changed = {
        name.partition('.')[2]: 1e-3 * (new - old) for name, (old, new) in round_.pins.items()
    }
    for pin, error in (('x-rot-point', 'X0C'), ('y-rot-point', 'Y0C')):
        assert changed[pin] == pytest.approx(round_.result.tables.location[error].value, abs=2e-9)
    write_trunnion_loop(round_, tmp_path)
    told = json.loads((tmp_path / 'loop.json').read_text())
    assert told['after_um'] == pytest.approx(1e6 * proof.after)
    assert np.mean([pose['after_um'] for pose in told['poses']]) == pytest.approx(told['after_um'])
    assert f'{told["after_um"]:.2f}' in (tmp_path / 'loop.html').read_text()
    assert read_bag(tmp_path / 'bags' / 'fit').axis_paths[-1].target == 'nest-3'
    assert load_tables(tmp_path / 'calibration/error_tables.json').tables.location


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'chain': 'w-C-b-X-Y-Z-A-t'}, 'not one of xyzac-trt-kins'),
        ({'target_offset': [0.01, 0.0, -0.02]}, 'a tool length along Z only'),
        ({'tracker': {'u_range': 5e-7, 'u_angle': 2e-6, 'link': 'w'}}, 'tracker: link'),
    ],
)
def test_a_trunnion_that_the_control_cannot_hold_is_refused(change, words, monkeypatch):
    monkeypatch.setattr(trunnion, 'trunnion_module', lambda name, conventional: None)
    with pytest.raises(ConfigError, match=words):
        trunnion.check_trunnion(machine_from_dict({**trunnion_cell().to_dict(), **change}))


def test_ways_and_machines_that_do_not_go_together_are_refused(tmp_path, capsys):
    for machine, way in ((some_machine(), 'pivot'), (trunnion_cell(), 'volume')):
        file = tmp_path / 'machine.yaml'
        file.write_text(yaml.safe_dump(machine.to_dict()))
        assert run('loop', '--machine', file, '--out', tmp_path / 'x', '--compensate', way) == 2
        assert f'--compensate {way}: the machine has' in capsys.readouterr().err


@installed
@pytest.mark.xdist_group('linuxcnc')
def test_linuxcnc_turns_about_the_exported_pivot():
    if control.LOCK.exists():
        pytest.skip('LinuxCNC runs on this computer already')
    machine = trunnion_cell()
    module = trunnion.check_trunnion(machine)
    rng = np.random.default_rng(8)
    own = random_tables(machine, 5e-5, rng)
    held = location_only(machine, rng, tilts=False)
    motions = {str(m): own.motions[m] for m in machine.motions if m[1] == m[2] and m[2] in 'AC'}
    held = replace(held, motions={**held.motions, **motions})
    poses = trunnion.Poses.drawn(machine, rng, 3)
    text, seconds = trunnion.pose_program(machine, poses)
    check = control.Program(trunnion.POSES_FILE, text, 3 * seconds + 20)
    ini = files.ini_text(machine, ACCELERATION, 0.3, f'{module} sparm=identityfirst')
    content = TablesFile(held)
    pivot = export_format('pivot').export(Request(content, 'p.txt')).files['p.txt'].decode()
    joints = dict(export_format('linuxcnc').export(Request(content, trunnion.JOINTS)).files)
    piece = joints.pop(trunnion.JOINTS).decode()
    old = ''.join(f'setp {name} {value:.6f}\n' for name, value in trunnion_pins(machine).items())
    left = []
    for pins, extra, own_ini in (
        (old, {}, ini), (trunnion.pivot_lines(pivot), joints, files.insert_piece(ini, piece)),
    ):  # fmt: skip
        given = files.written_files(machine, own_ini, extra, kinematics=module, pins=pins)
        (driven,) = control.drive(machine, given, [check])
        motor = trunnion.motors_at_poses(machine, driven, poses)
        left.append(np.linalg.norm(exact_position(held, motor) - poses.place, axis=1))
    assert left[0].min() > 2e-5
    assert left[1].max() < 0.01 * left[0].mean()

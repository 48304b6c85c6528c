# SPDX-License-Identifier: Apache-2.0
"""Exports of machines with rotary axes, read back and applied by transforms of their own."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from export_readers import etalon_blocks, evenly, sinumerik_values
from test_chain import constant, machine_of

from otf_core.exports import export_format
from otf_core.exports.format import Request, remaining_error
from otf_core.exports.pivot import correct_axis_lines
from otf_core.model.chain import exact_position, nominal_position
from otf_core.model.tables import MotionTable, ScalarError
from otf_core.prediction.calibration_document import CalibrationDocument
from otf_core.prediction.predict import Predictor
from otf_core.sim.cell import random_tables

CHAINS = ('w-C-A-b-Y-X-Z-t', 'w-C-b-X-Y-Z-B-t', 'w-X-b-Y-Z-C-A-t')


def five_axes(chain=CHAINS[0], seed=3):
    """A machine whose centres lie off the origin and whose C turns the other way."""
    machine = machine_of(chain, None)
    rng = np.random.default_rng(seed)
    axes = dict(machine.axes)
    for name in machine.rotary_names:
        x, y, z = axes[name].direction
        sense = -1.0 if name == 'C' else 1.0
        centre = tuple(rng.uniform(-0.1, 0.1, 3))
        axes[name] = replace(
            axes[name], direction=(sense * x, sense * y, sense * z), centre=centre
        )
    return replace(machine, axes=axes)


def exported(name, tables, sign='error', **extra):
    chosen = export_format(name)
    sign = sign if chosen.sign_is_asked else None
    return chosen.export(Request(CalibrationDocument.of_tables(tables, **extra), 'cell.txt', sign))


def places(machine, count=60):
    rng = np.random.default_rng(5)
    return rng.uniform(machine.lower, machine.upper, (count, len(machine.axis_names)))


# A reader of ISG CSV that knows what the manual and the head of the file say, and no more.


def shift(x, y, z):
    out = np.eye(4)
    out[:3, 3] = x, y, z
    return out


def turn(vector):
    """Rotation by a vector, by the series of the matrix exponential."""
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    total, term = np.eye(3), np.eye(3)
    for k in range(1, 25):
        term = term @ cross / k
        total = total + term
    out = np.eye(4)
    out[:3, :3] = total
    return out


def about(point, transform):
    return shift(*point) @ transform @ shift(*-np.asarray(point))


class IsgReader:
    """Position of the target relative to the table by a CSV, mm and degrees."""

    def __init__(self, text, sign='error'):
        lines = text.splitlines()
        head = '\n'.join(line for line in lines if line.startswith('//'))
        blocks = [[]]
        for line in lines:
            if line == '#':
                blocks.append([])
            elif not line.startswith('//'):
                blocks[-1].append(line.split('\t'))
        factor = 1.0 if sign == 'error' else -1.0
        self.constant = dict(zip(blocks[0][0], map(float, blocks[0][1]), strict=True))
        self.constant = {n: v if n[0] == 'P' else factor * v for n, v in self.constant.items()}
        self.columns = {}
        for (argument, *names), *rows in blocks[1:]:
            values = np.array(rows, float)
            for k, name in enumerate(names, start=1):
                assert name[2] == argument
                self.columns[name] = values[:, 0], factor * values[:, k]
        self.chain = re.search(r'chain (\S+),', head)[1]
        vector = r'\((\S+), (\S+), (\S+)\)'
        self.target = np.array(re.search(rf'target offset {vector} mm', head).groups(), float)
        self.direction = {
            name: np.array(xyz, float)
            for name, *xyz in re.findall(
                rf'([ABC]): .* relative to the table about {vector}', head
            )
        }

    def six(self, axis, at):
        values = [np.interp(at, *self.columns[f'E{d}{axis}']) for d in 'XYZABC']
        return shift(*values[:3]), turn(values[3:])

    def link(self, axis, at, exact):
        """Transform of one axis: programmed, or with its errors."""
        if axis in 'XYZ':
            direction = np.eye(3)['XYZ'.index(axis)]
            if exact and axis == 'Y':
                direction -= np.array([self.constant['C0Y'], 0, 0])
            if exact and axis == 'Z':
                direction += np.array([self.constant['B0Z'], -self.constant['A0Z'], 0])
            return shift(*at * direction)
        centre = np.array([self.constant[f'P{d}{axis}'] for d in 'XYZ'])
        moved = about(centre, turn(np.radians(at) * self.direction[axis]))
        if not exact:
            return moved
        line = [self.constant.get(f'{d}0{axis}', 0.0) for d in 'XYZABC']
        line = shift(*line[:3]) @ about(centre, turn(line[3:]))
        return line @ moved @ np.linalg.inv(line)

    def error(self, axis, at):
        translation, rotation = self.six(axis, at)
        if axis in 'XYZ':
            return translation @ rotation
        centre = np.array([self.constant[f'P{d}{axis}'] for d in 'XYZ'])
        return translation @ about(centre, rotation)

    def position(self, letters, q, exact=True):
        """Where the target is relative to the table, mm, for one position of the axes."""
        at = dict(zip(letters, q, strict=True))
        table, _, tool = self.chain[2:-2].replace('-', '').partition('b')
        total = np.eye(4)
        for side, axes in ((0, table), (1, tool)):
            for axis in axes:
                own = self.link(axis, at[axis], exact)
                error = self.error(axis, at[axis]) if exact else np.eye(4)
                before = (axis in 'XYZ') == (side == 0)  # linear: at the carriage; rotary: at b
                total = total @ error @ own if before else total @ own @ error
        return (total @ [*self.target, 1.0])[:3]

    def corrected(self, letters, q):
        """Commands whose linear axes bring the target where it belongs, as the control would."""
        wanted, found = self.position(letters, q, exact=False), np.array(q, float)
        for _ in range(2):
            slope = np.zeros((3, 3))
            for k in range(3):
                step = np.zeros(len(q))
                step[k] = 1.0
                slope[:, k] = self.position(letters, found + step, exact=False)
                slope[:, k] -= self.position(letters, found, exact=False)
            left = wanted - self.position(letters, found)
            found[:3] += np.linalg.solve(slope, left)
        return found


class EtalonReader(IsgReader):
    """The same by the blocks of the Etalon exchange format: errors alone."""

    def __init__(self, text, sign='error'):
        head = '\n'.join(line for line in text.splitlines() if line.startswith('//'))
        self.constant, self.columns = etalon_blocks(text)
        vector = r'\((\S+), (\S+), (\S+)\)'
        self.direction = {}
        for name, *values in re.findall(
            rf'([ABC]): .* relative to the table about {vector}, .* through {vector} mm', head
        ):
            self.direction[name] = np.array(values[:3], float)
            centre = zip('XYZ', values[3:], strict=True)
            self.constant |= {f'P{d}{name}': float(v) for d, v in centre}
        self.chain = re.search(r'chain (\S+),', head)[1]
        self.target = np.array(re.search(rf'target offset {vector} mm', head).groups(), float)


READERS = {'isg': IsgReader, 'etalon': EtalonReader}


def units(machine):
    return np.array(
        [np.degrees(1.0) if machine.axes[a].rotary else 1e3 for a in machine.axis_names]
    )


def left_by_file(tables, q, sign='error', name='isg'):
    """Position errors before and after the linear axes were corrected by the file, m."""
    machine = tables.machine
    text = exported(name, tables, sign).files['cell.txt'].decode()
    reader, scale = READERS[name](text, sign), units(machine)
    command = np.array([reader.corrected(machine.axis_names, row * scale) for row in q]) / scale
    wanted = nominal_position(machine, q)
    before = np.linalg.norm(exact_position(tables, q) - wanted, axis=1)
    return before, np.linalg.norm(exact_position(tables, command) - wanted, axis=1)


@pytest.mark.parametrize(
    ('name', 'chain'), [*(('isg', chain) for chain in CHAINS), ('etalon', CHAINS[1])]
)
def test_a_file_takes_the_position_error_off_in_five_axes(name, chain):
    tables = random_tables(five_axes(chain), 5e-5, np.random.default_rng(8))
    before, after = left_by_file(tables, places(tables.machine), name=name)
    assert before.mean() > 4e-5
    assert after.mean() < 0.05 * before.mean()
    assert after.max() < 0.05 * before.max()


@pytest.mark.parametrize(
    'name', ['X0C', 'B0C', 'Z0A', 'C0A', 'EXC', 'EBC', 'ECC', 'EAA', 'EZA', 'A0Z']
)
def test_every_column_has_its_sign(name):
    size = 1e-4
    tables = constant(five_axes(), size, name)
    for sign, factor in (('error', 1.0), ('correction', -1.0)):
        text = exported('isg', tables, sign).files['cell.txt'].decode()
        rows = [line.split('\t') for line in text.splitlines() if not line.startswith('//')]
        (head, row) = next((h, r) for h, r in itertools.pairwise(rows) if name in h)
        unit = 1e3 if name[1 if name[0] == 'E' else 0] in 'XYZ' else 1.0
        assert float(row[head.index(name)]) == pytest.approx(factor * size * unit)
        for file in READERS:
            before, after = left_by_file(tables, places(tables.machine, 5), sign, file)
            assert after.max() < 0.02 * before.max()


# New pivot points: a control that knows the moved lines drives as if there were no location error.


def location_only(machine, rng, tilts=True):
    tables = constant(machine)
    location = {
        n: ScalarError(rng.uniform(-1e-4, 1e-4) if tilts or n[0] in 'XYZ' else 0.0)
        for n in machine.location
    }
    return replace(tables, location=location)


@pytest.mark.parametrize('chain', [*CHAINS, 'w-X-Y-b-Z-B-t'])
def test_moved_lines_take_the_place_of_location_errors(chain):
    tables = location_only(five_axes(chain), np.random.default_rng(1))
    q = places(tables.machine)
    found = nominal_position(correct_axis_lines(tables), q)
    assert np.abs(exact_position(tables, q) - found).max() < 1e-11  # tables to 1 nm, 1 nrad apart
    assert np.abs(exact_position(tables, q) - nominal_position(tables.machine, q)).max() > 2e-5


def trunnion(tilting):
    """A trunnion whose tables turn right-handed, as LinuxCNC has it, target in the spindle."""
    machine = five_axes(f'w-C-{tilting}-b-Y-X-Z-t')
    axes = dict(machine.axes)
    for name, direction in (('C', (0.0, 0.0, -1.0)), ('A', (-1.0, 0, 0)), ('B', (0, -1.0, 0))):
        if name in axes:
            axes[name] = replace(axes[name], direction=direction)
    return replace(machine, axes=axes, target_offset=np.array([0.0, 0.0, -0.15]))


def trt_position(tilting, pin, q, length):
    """What the trunnion kinematics of LinuxCNC say of joints (mm, rad), from their description.

    The tool stands on a table C that a table A or B carries: turned back by both tables about
    their centres, C at the rot-points, the other by the offsets (and the tool) from there.
    """
    out = []
    for x, y, z, tilt, turning in q:
        turned = np.array([pin['x-rot-point'], pin['y-rot-point'], pin['z-rot-point'] + length])
        offset = [pin.get('x-offset', 0.0), pin.get('y-offset', 0.0), pin['z-offset']]
        axis = np.eye(3)['AB'.index(tilting)]
        tilted = turned + offset
        point = turn(-tilt * axis)[:3, :3] @ (np.array([x, y, z]) - tilted) + tilted
        out.append(turn([0, 0, -turning])[:3, :3] @ (point - turned) + turned)
    return np.array(out)


@pytest.mark.parametrize('tilting', ['A', 'B'])
def test_pins_of_linuxcnc_put_the_tool_where_the_moved_lines_say(tilting):
    machine = trunnion(tilting)
    tables = location_only(machine, np.random.default_rng(2), tilts=False)
    text = exported('pivot', tables).files['cell.txt'].decode()
    pin = dict(re.findall(rf'setp xyz{tilting.lower()}c-trt-kins\.(\S+) (\S+)', text))
    pin = {k: float(v) for k, v in pin.items()}
    q = places(machine)
    order = [machine.column(a) for a in ('X', 'Y', 'Z', tilting, 'C')]
    found = trt_position(tilting, pin, q[:, order] * [1e3, 1e3, 1e3, 1, 1], 150.0)
    wanted = 1e3 * (exact_position(tables, q) - machine.target_offset)
    np.testing.assert_allclose(found, wanted, atol=1e-5)  # mm; pins to six decimals


@pytest.mark.parametrize(('chain', 'kind'), list(zip(CHAINS, 'PMT', strict=True)))
def test_vectors_of_sinumerik_lead_to_the_moved_centres(chain, kind):
    tables = location_only(five_axes(chain), np.random.default_rng(3))
    text = exported('pivot', tables).files['cell.txt'].decode()
    assert f'$TC_CARR23[n]="{kind}"' in text
    numbers = {int(k): float(v) for k, v in re.findall(r'(?m)^\$TC_CARR(\d+)\[n\]=(\S+)', text)}
    first = {'I1': 1, 'I2': 4, 'V1': 7, 'V2': 10, 'I3': 15, 'I4': 18}
    vector = {
        n: np.array([numbers.get(k + j, np.nan) for j in range(3)]) for n, k in first.items()
    }
    moved = correct_axis_lines(tables)
    one, two = {'P': 'AC', 'M': 'BC', 'T': 'CA'}[kind]
    if kind == 'P':
        reached = vector['I2'], vector['I2'] + vector['I3']
        np.testing.assert_allclose(vector['I2'] + vector['I3'] + vector['I4'], 0, atol=2e-6)
    elif kind == 'T':
        reached = vector['I3'] + vector['I2'], vector['I3']
        np.testing.assert_allclose(vector['I1'] + vector['I2'] + vector['I3'], 0, atol=2e-6)
    else:
        reached = vector['I2'], vector['I3']
        np.testing.assert_allclose([vector['I1'], vector['I4']], [-vector['I2'], -vector['I3']])
    for axis, centre, direction in zip((one, two), reached, ('V1', 'V2'), strict=True):
        np.testing.assert_allclose(centre, 1e3 * np.array(moved.axes[axis].centre), atol=2e-6)
        np.testing.assert_allclose(vector[direction], moved.axes[axis].direction, atol=1e-9)


# Positioning of rotary axes in SINUMERIK ENC_COMP.


def encoder_correction(text, machine, q):
    """What the control adds to commands: values move an axis in the negative direction."""
    values, other = sinumerik_values(text, 'AA_ENC_COMP')
    change = np.zeros_like(q)
    for k, axis in enumerate(machine.axis_names):
        scale = np.degrees(1.0) if machine.axes[axis].rotary else 1e3
        own = sorted((int(key[1]), v) for key, v in values.items() if key[2] == f'{axis}1')
        low, high, step = (float(other[f'_{w}', f'{axis}1']) for w in ('MIN', 'MAX', 'STEP'))
        change[:, k] = -evenly([v for _, v in own], low, high, step, scale * q[:, k]) / scale
    return change


def joint_correction(files, machine, q):
    """What LinuxCNC adds to commands: nominal minus actual position, mm and degrees."""
    change = np.zeros_like(q)
    piece = files['cell.ini'].decode()
    for k, axis in enumerate(machine.axis_names):
        scale = np.degrees(1.0) if machine.axes[axis].rotary else 1e3
        name = re.search(rf'\[JOINT_{k}\]\nCOMP_FILE = (\S+)', piece)[1]
        rows = [r.split() for r in files[name].decode().splitlines() if r[0] != '#']
        nominal, forward, backward = np.array(rows, float).T
        np.testing.assert_array_equal(forward, backward)
        change[:, k] = np.interp(scale * q[:, k], nominal, nominal - forward) / scale
    return change


@pytest.mark.parametrize('chain', CHAINS)
@pytest.mark.parametrize('letter', ['A', 'C'])
def test_encoder_tables_take_the_angular_positioning_off(chain, letter):
    letter = letter if letter in chain else 'B'
    machine = five_axes(chain)
    nodes = np.linspace(-2.0, 2.0, 9)
    value = 1e-4 * np.sin(nodes)
    name = f'E{letter}{letter}'
    curve = MotionTable(nodes, value, np.zeros(9))
    others = {
        m: MotionTable(np.linspace(-0.3, 0.3, 3), np.zeros(3), np.zeros(3))
        if m.axis in 'XYZ'
        else MotionTable(nodes, np.zeros(9), np.zeros(9))
        for m in machine.motions
    }
    tables = replace(constant(machine), motions={**others, name: curve})
    made, joints = exported('sinumerik-enc', tables), exported('linuxcnc', tables)
    text = made.files['cell.txt'].decode()
    q = places(machine)
    wanted = nominal_position(machine, q)
    before = np.linalg.norm(exact_position(tables, q) - wanted, axis=1)
    assert before.max() > 5e-6
    for file, change in (
        (made, encoder_correction(text, machine, q)),
        (joints, joint_correction(joints.files, machine, q)),
    ):
        after = np.linalg.norm(exact_position(tables, q + change) - wanted, axis=1)
        assert after.max() < 0.01 * before.max()
        assert remaining_error(tables, file.held).after_max < 0.01 * before.max()
    assert 'angular positioning' in text
    assert any('degrees' in remark for remark in joints.remarks)


def test_an_endless_axis_joins_its_ends_in_the_encoder_table():
    machine = five_axes()
    turning = replace(machine.axes['C'], min=0.0, max=2 * np.pi, endless=True)
    machine = replace(machine, axes={**machine.axes, 'C': turning})
    tables = random_tables(machine, 5e-5, np.random.default_rng(1))
    text = exported('sinumerik-enc', tables).files['cell.txt'].decode()
    assert '$AA_ENC_COMP_IS_MODULO[0,C1]=1' in text
    assert '$AA_ENC_COMP_IS_MODULO[0,A1]=0' in text
    assert '$AA_ENC_COMP_MAX[0,C1]=360.000000' in text
    values = sinumerik_values(text, 'AA_ENC_COMP')[0]
    last = max(int(key[1]) for key in values if key[2] == 'C1')
    assert values['0', '0', 'C1'] == pytest.approx(values['0', str(last), 'C1'], abs=2e-6)


@pytest.mark.parametrize('chain', CHAINS)
def test_corrected_commands_of_the_linear_axes_put_the_target_where_it_is_wanted(chain):
    """What the compensator answers: the position of the target on the table, at any angles."""
    tables = random_tables(five_axes(chain), 5e-5, np.random.default_rng(8))
    machine, q = tables.machine, places(tables.machine)
    command = Predictor.of(CalibrationDocument.of_tables(tables)).corrected(q)
    turning = [machine.column(a) for a in machine.rotary_names]
    np.testing.assert_array_equal(command[:, turning], q[:, turning])
    wanted = nominal_position(machine, q)
    before = np.linalg.norm(exact_position(tables, q) - wanted, axis=1)
    after = np.linalg.norm(exact_position(tables, command) - wanted, axis=1)
    assert after.max() < 1e-7 < 0.01 * before.max()

# SPDX-License-Identifier: Apache-2.0
"""Readers of exports, written from the descriptions of the formats alone."""

import re

import numpy as np
import pytest
from core_cells import error_of, some_machine

from otf_core.exports import HOMES
from otf_core.prediction.calibration_document import tables_from_dict, tables_to_dict
from otf_core.sim.cell import random_tables


def numbers(text, comment):
    """Rows of text that are no comments and no blanks."""
    return [line for line in text.splitlines() if line.strip() and not line.startswith(comment)]


def read_linuxcnc(files, q, sign):
    """Correction in m: the control adds nominal minus actual, columns in mm."""
    change = np.zeros_like(q)
    ini = files['cell.ini'].decode()
    for joint in range(3):
        part = ini.split(f'[JOINT_{joint}]')[1].split('[JOINT')[0]
        name = re.search(r'COMP_FILE = (\S+)', part).group(1)
        assert 'COMP_FILE_TYPE = 0' in part
        rows = []
        for line in files[name].decode().splitlines():
            try:
                nominal, forward, reverse = map(float, line.split())
            except ValueError:
                break  # the control stops here too
            rows.append((nominal, nominal - 0.5 * (forward + reverse)))
        nominal, correction = np.array(rows).T
        assert np.all(np.diff(nominal) > 0) and len(nominal) <= 256
        change[:, joint] = 1e-3 * np.interp(1e3 * q[:, joint], nominal, correction)
    return change


def sinumerik_values(text, name):
    """Values by table or axis and number, other variables by table or axis."""
    values, other = {}, {}
    pattern = rf'\${name}(_\w+)?\[([^\]]+)\]=(\S+)'
    for kind, index, value in re.findall(pattern, text):
        if kind:
            other[kind, index.split(',')[-1]] = value.strip('"')
        else:
            values[tuple(index.split(','))] = float(value)
    return values, other


def evenly(points, low, high, step, at):
    assert low + step * (len(points) - 1) == pytest.approx(high, abs=1e-5)
    return np.interp(at, low + step * np.arange(len(points)), points)


def read_sinumerik_enc(files, q, sign):
    """A positive value moves the axis in the negative direction."""
    (text,) = (f.decode() for f in files.values())
    assert text.startswith('%_N_AX_EEC_INI') and text.endswith('M17\n')
    values, other = sinumerik_values(text, 'AA_ENC_COMP')
    change = np.zeros_like(q)
    for k, axis in enumerate(('X1', 'Y1', 'Z1')):
        points = [values[key] for key in sorted(
            (key for key in values if key[2] == axis), key=lambda key: int(key[1])
        )]  # fmt: skip
        low, high, step = (float(other[f'_{w}', axis]) for w in ('MIN', 'MAX', 'STEP'))
        change[:, k] = -1e-3 * evenly(points, low, high, step, 1e3 * q[:, k])
    return change


def read_sinumerik_cec(files, q, sign):
    """Tables that act on the output axis by the position of the input axis."""
    (text,) = (f.decode() for f in files.values())
    values, other = sinumerik_values(text, 'AN_CEC')
    change = np.zeros_like(q)
    for table in '012345':
        points = [values[key] for key in sorted(
            (key for key in values if key[0] == table), key=lambda key: int(key[1])
        )]  # fmt: skip
        low, high, step = (float(other[f'_{w}', table]) for w in ('MIN', 'MAX', 'STEP'))
        base, moved = ('XYZ'.index(other[w, table][0]) for w in ('_INPUT_AXIS', '_OUTPUT_AXIS'))
        at = evenly(points, low, high, step, 1e3 * q[:, base])
        change[:, moved] += 1e-3 * at * (1 if sign == 'correction' else -1)
    return change


def by_iso_names(columns, square, q, sign):
    """Sum of the contract over columns of mm and rad: (axis, direction) to positions, values."""
    truth = random_tables(some_machine(pitch=0.04), 5e-5, np.random.default_rng(11))
    factor = 1 if sign == 'error' else -1
    data = tables_to_dict(truth)
    for name, motion in data['motions'].items():
        position, value = columns[name]
        scale = 1e-3 if motion['unit'] == 'm' else 1.0
        motion['position'] = [1e-3 * p for p in position]
        motion['value'] = [factor * scale * v for v in value]
        motion['u'] = [0.0] * len(position)
    for name, value in square.items():
        data['squareness'][name]['value'] = factor * value
    return -error_of(tables_from_dict(data, 'read').tables, q)


def read_isg(files, q, sign):
    (text,) = (f.decode() for f in files.values())
    blocks = [numbers(b, '//') for b in text.split('\n#\n')]
    square = dict(zip(blocks[0][0].split(), map(float, blocks[0][1].split()), strict=True))
    columns = {}
    for block in blocks[1:]:
        header, rows = block[0].split('\t'), np.array([r.split('\t') for r in block[1:]], float)
        for k, name in enumerate(header[1:], start=1):
            columns[name] = rows[:, 0], rows[:, k]
    return by_iso_names(columns, square, q, sign)


def etalon_blocks(text):
    """Numbers and tables of the Etalon exchange format by the name of their block."""
    values, columns, name, rows = {}, {}, None, None
    for line in text.splitlines():
        words = line.partition('//')[0].replace('=', ' = ').split()
        if words[:1] and words[0].startswith('['):
            name = words[0].strip('[]')
            assert name not in {**values, **columns}, name
        elif words[:2] == ['VALUE', '=']:
            values[name] = float(words[2])
        elif words == ['Gridpoints', '=', '{']:
            rows = []
        elif words == ['}']:
            columns[name], rows = tuple(np.array(rows).T), None
        elif words:
            rows.append([float(word) for word in words])
    return values, columns


def read_etalon(files, q, sign):
    (text,) = (f.decode() for f in files.values())
    values, columns = etalon_blocks(text)
    return by_iso_names(columns, values, q, sign)


def trilinear(axes, error, q):
    from scipy.interpolate import RegularGridInterpolator

    return -RegularGridInterpolator(axes, error)(q)


def read_lattice_csv(files, q, sign):
    (text,) = (f.decode() for f in files.values())
    header, *rows = numbers(text, '#')
    assert header.startswith('x,y,z,dx,dy,dz')
    values = np.array([row.split(',') for row in rows], float)
    axes = [np.unique(values[:, k]) for k in range(3)]
    return trilinear(axes, values[:, 3:6].reshape(*map(len, axes), 3), q)


ROTARY_ONLY = ('pivot',)
"""Formats of machines with rotary axes alone."""
READERS = {
    name: globals()['read_' + name.replace('-', '_')] for name in HOMES if name not in ROTARY_ONLY
}

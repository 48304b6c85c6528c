# SPDX-License-Identifier: Apache-2.0
"""Files as they should not be: mutations of good ones, for all readers.

Bytes are flipped, cut, doubled and filled; in text, numbers grow to hundreds of digits, values are
nested a hundred thousand deep, keys repeat, aliases multiply.
"""

import json
import re

import numpy as np
import yaml
from bag_cells import MESSAGES, write_mcap
from mcap.writer import CompressionType

from otf_core.bags.bag import read_bag
from otf_core.effects.effects_yaml import read_effects
from otf_core.errors import OtfError
from otf_core.inputs.nc_program import read_program
from otf_core.inputs.path_file import read_plan, read_points
from otf_core.model.machine import load_machine
from otf_core.noise.noise_model import read_noise
from otf_core.prediction.calibration_document import load_tables

MACHINE = {
    'name': 'cell',
    'chain': 'w-Y-b-X-Z-t',
    'axes': {a: {'min': -0.1, 'max': 0.5, 'table_pitch': 0.05} for a in 'XYZ'},
    'target_offset': [0.0, 0.01, -0.15],
    'tracker': {'u_range': 5e-07, 'u_angle': 2e-06},
    'uncertainty': {'tracker_scale': 1e-06},
}
EFFECTS = [{'effect': 'backlash', 'parameters': {'B_X': 1e-5, 'B_Y': 2e-5}}]
NOISE = {'schema': 'otf-noise/1', 'u_range': 1e-6, 'u_angle': [1e-6, 2e-6], 'white_range': 5e-7,
         'white_angle': [5e-7, 5e-7], 'correlation_time': 0.2, 'standstills': 3,
         'samples': 900}  # fmt: skip
LONG = 3000
"""Characters; no message of an error is longer."""


def tables():
    """The shortest file of error tables."""
    names = [f'E{d}{a}' for a in 'XYZ' for d in 'XYZ'] + [f'E{r}{a}' for a in 'XYZ' for r in 'ABC']
    motions = {
        n: {'axis': n[2], 'unit': 'm' if n[1] in 'XYZ' else 'rad', 'position': [-0.1, 0.5],
            'value': [0.0, 1e-5], 'u': [0.0, 1e-6], 'identifiable': True} for n in names
    }  # fmt: skip
    square = {n: {'value': 1e-5, 'u': 1e-6} for n in ('C0Y', 'B0Z', 'A0Z')}
    return {'schema': 'otf-error-tables/1', 'machine': MACHINE, 'motions': motions,
            'squareness': square, 'alignment': {}, 'fit': {}}  # fmt: skip


def plan():
    """A plan of two legs."""
    points = [[0.0, 0.0, 0.0], [0.3, 0.0, 0.1], [0.3, 0.2, 0.0]]
    part = {'target': 'tool', 'positions': points, 'feed': [0.05, 0.05], 'dwell': [0.0, 0.5, 0.0]}
    assumed = {'tracker_link': 'w', 'tracker_place': [0.0, -0.5, 0.1]}
    return {'schema': 'otf-plan/2', 'axes': ['X', 'Y', 'Z'], 'parts': [part], 'assumed': assumed}


GCODE = b"""%
G21 G90 G17 G54
N10 G0 X0 Y0 Z0 (START)
N20 G1 X50. F900 M3 S500
N30 G3 X0 Y50 I-50 J0
G91 G2 X10 Y10 R10
G4 X2.5
G1 Z-1.5
M30
%
"""
KLARTEXT = b"""0 BEGIN PGM A MM
1 L X+50 Y+0 Z+0 FMAX M3
2 CC X+0 Y+0
3 C X+0 Y+50 DR+ F100
4 CYCL DEF 9.0 DWELL TIME
5 CYCL DEF 9.1 DWELL 2
6 L IX+10 Z-5,5
7 CR X+20 Y+60 R+20 DR-
8 END PGM A MM
"""


def readers(folder):
    """Name of every kind of input: its good bytes, and what reads a file of it."""
    machine = folder / 'good.yaml'
    machine.write_text(yaml.safe_dump(MACHINE))
    known = load_machine(machine)
    found = {
        'machine.yaml': (yaml.safe_dump(MACHINE, sort_keys=False).encode(), load_machine),
        'effects.yaml': (
            yaml.safe_dump(EFFECTS).encode(), lambda file: read_effects(file, known)
        ),
        'points.csv': (b'x,y,z\n0.1,0.2,0.3\n0.2,-1e-3,0.0\n', read_points),
        'error_tables.json': (json.dumps(tables()).encode(), load_tables),
        'noise.json': (json.dumps(NOISE).encode(), read_noise),
        'plan.json': (json.dumps(plan()).encode(), read_plan),
        'program.nc': (GCODE, read_program),
        'program.h': (KLARTEXT, read_program),
    }  # fmt: skip
    for name, options in (
        ('zstd.mcap', {'compression': CompressionType.ZSTD}),
        ('plain.mcap', {'compression': CompressionType.NONE}),
        ('unchunked.mcap', {'use_chunking': False}),
    ):
        file = write_mcap(folder / name, MESSAGES[:60], enable_data_crcs=False, **options)
        found[name] = (file.read_bytes(), read_bag)
        recover = lambda file: read_bag(file, recover=True)  # noqa: E731
        found[f'recovered {name}'] = (file.read_bytes(), recover)
    return found


NUMBER = re.compile(rb'-?\d+(\.\d+)?([eE][-+]?\d+)?')
SPOILT = (b'1' + b'0' * 400, b'1e400', b'-1e400', b'nan', b'.inf', b'1' * 5000, b'null', b'true',
          b'[' * 100_000, b'{"a":' * 50_000, b'""', b'0x', b'2020-99-99', b'!!python/name:os',
          b'&a [*a]', b'*unknown', b'<<: *a')  # fmt: skip


def aliases(depth):
    """A short text that stands for 9^depth items."""
    rows = ['a0: &a0 [' + ', '.join('x' * 9) + ']']
    rows += [f'a{k}: &a{k} [' + ', '.join([f'*a{k - 1}'] * 9) + ']' for k in range(1, depth)]
    merged = ['m0: &m0 {k: 1}']
    merged += [f'm{k}: &m{k} {{<<: [{", ".join([f"*m{k - 1}"] * 9)}]}}' for k in range(1, depth)]
    return '\n'.join([*rows, *merged, f'name: *a{depth - 1}', '']).encode()


def mutated(good, rng):
    """Return bytes that are somehow not what they were."""
    data = bytearray(good)
    for _ in range(int(rng.integers(1, 4))):
        at, kind = int(rng.integers(0, max(1, len(data)))), int(rng.integers(0, 8))
        length = int(rng.choice([1, 2, 8, 100]))
        if kind == 0:
            data[at : at + 1] = bytes([int(rng.integers(0, 256))])
        elif kind == 1:
            del data[at : at + length]
        elif kind == 2:
            data[at:at] = data[max(0, at - length) : at]
        elif kind == 3:
            data[at : at + length] = rng.bytes(length)
        elif kind == 4:
            data[at : at + 8] = bytes([255] * 8) if rng.random() < 0.5 else bytes(8)
        elif kind == 5:
            del data[at:]
        else:
            numbers = list(NUMBER.finditer(data))
            if numbers and not data.startswith(b'\x89MCAP'):
                place = numbers[int(rng.integers(0, len(numbers)))]
                data[place.start() : place.end()] = SPOILT[int(rng.integers(0, len(SPOILT)))]
    return bytes(data)


def trouble(read, file, data):
    """Say what is wrong with how a file is read; empty if it is read, or refused in order."""
    file.write_bytes(data)
    try:
        read(file)
    except OtfError as error:
        text = str(error)
        return f'message of {len(text)} characters' if len(text) > LONG or not text else ''
    except Exception as error:  # noqa: BLE001
        # whatever comes is what is looked for
        return f'{type(error).__name__}: {error}'[:300]
    return ''


def look_for_trouble(reader, file, count, seed):
    """Mutate an input so often; return the first trouble and its input, or None."""
    good, read = reader
    rng = np.random.default_rng(seed)
    for _ in range(count):
        data = mutated(good, rng)
        found = trouble(read, file, data)
        if found:
            return found, data
    return None

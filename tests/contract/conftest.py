# SPDX-License-Identifier: Apache-2.0
"""Results that several tests look at: each is made once, by whichever process asks first."""

import json

import pytest
from command import made_once, otf, read, shared
from golden import RECORDINGS


class Result:
    """What a recording of the contract gives now."""

    def __init__(self, folder):
        self.folder = folder / 'out'
        self.code = int((folder / 'code').read_text())
        file = 'gap.json' if (self.folder / 'gap.json').exists() else 'error_tables.json'
        self.file = self.folder / file
        self.document = read(self.file)


@pytest.fixture(scope='session')
def result_of(tmp_path_factory):
    """Function from the name of a recording to its ``Result``."""
    place = shared(tmp_path_factory) / 'results'

    def found(name):
        def make(folder):
            done = otf(*RECORDINGS[name].words(folder / 'out'))
            assert (folder / 'out').is_dir(), done.said
            (folder / 'code').write_text(str(done.code))

        return Result(made_once(place / name, make))

    return found


AXES = {'X': (0.0, 0.15, 0.3), 'Y': (0.0, 0.1, 0.2), 'Z': (-0.2, -0.1, 0.0)}
MACHINE = {
    'name': 'cell-300',
    'chain': 'w-b-X-Y-Z-t',
    'axes': {
        axis: {'min': at[0], 'max': at[-1], 'table_pitch': round(at[1] - at[0], 9)}
        for axis, at in AXES.items()
    },
    'target_offset': [0.0, 0.0, -0.15],
    'tracker': {'u_range': 0.5e-6, 'u_angle': 2.0e-6},
}


@pytest.fixture
def machine_file(tmp_path):
    """machine.yaml of a small machine; JSON is YAML."""
    file = tmp_path / 'machine.yaml'
    file.write_text(json.dumps(MACHINE))
    return file


@pytest.fixture
def tables_file(tmp_path):
    """Function that writes error_tables.json of errors stated by hand; all others are zero."""

    def write(**errors):
        motions = {}
        for axis, at in AXES.items():
            for letter in 'XYZABC':
                name = f'E{letter}{axis}'
                motions[name] = {
                    'axis': axis,
                    'unit': 'm' if letter in 'XYZ' else 'rad',
                    'position': at,
                    'value': errors.get(name, (0.0, 0.0, 0.0)),
                    'u': [1e-7] * 3,
                    'identifiable': True,
                }
        square = {n: {'value': errors.get(n, 0.0), 'u': 1e-6} for n in ('C0Y', 'B0Z', 'A0Z')}
        fit = dict.fromkeys(('samples', 'used', 'unknowns', 'rank'), 1)
        fit |= dict.fromkeys(('path_mae_before', 'path_mae_after', 'residual_rms'), 0.0)
        pose = {'rotation': [[1, 0, 0], [0, 1, 0], [0, 0, 1]], 'translation': [0, 0, 0]}
        content = {
            'schema': 'otf-error-tables/1',
            'machine': MACHINE,
            'motions': motions,
            'squareness': square,
            'alignment': pose,
            'fit': fit,
        }
        file = tmp_path / 'tables.json'
        file.write_text(json.dumps(content))
        return file

    return write

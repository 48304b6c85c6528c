# SPDX-License-Identifier: Apache-2.0
"""Results that several tests look at: each is made once, by whichever process asks first."""

import json

import pytest
from command import made_once, otf, read, shared
from golden import RECORDINGS
from stated import MACHINE, tables


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
            done = otf(*RECORDINGS[name].words, '--out', folder / 'out')
            assert (folder / 'out').is_dir(), done.said
            (folder / 'code').write_text(str(done.code))

        return Result(made_once(place / name, make))

    return found


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
        file = tmp_path / 'tables.json'
        file.write_text(json.dumps(tables(**errors)))
        return file

    return write

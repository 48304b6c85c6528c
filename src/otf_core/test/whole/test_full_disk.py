# SPDX-License-Identifier: Apache-2.0
"""A full disk: the tables are there, the manifest names what is not."""

import errno
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from otf_core.files.output_folder import MANIFEST, OutputFolder
from otf_core.files.writing import DiskFull, write_if_possible, write_text

SMALL, LARGE = 'tables', 'residuals' * 100


@pytest.fixture
def little_room(monkeypatch):
    """Files of more than 100 byte do not fit."""
    replace = os.replace

    def full(source, target):
        if os.path.getsize(source) > 100 and not str(target).endswith(MANIFEST):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(source, target)

    monkeypatch.setattr(os, 'replace', full)


def test_files_that_do_not_fit_are_named_in_the_manifest(tmp_path, little_room):
    out = OutputFolder(tmp_path / 'out')
    with out.filled('calibrate') as folder:
        for name, text in (('small', SMALL), ('large', LARGE)):
            write = lambda: write_text(folder / name, text)  # noqa: B023, E731
            assert write_if_possible(out.missing, name, write) == (name == 'small')
    manifest = json.loads((tmp_path / 'out' / MANIFEST).read_text())
    assert manifest['missing'] == {'large': 'the disk is full'}
    assert list(manifest['sha256']) == ['small']
    assert sorted(p.name for p in (tmp_path / 'out').iterdir()) == [MANIFEST, 'small']
    assert out.missing_words == 'the disk is full: large not written'


def test_what_may_not_be_missing_is_refused_and_nothing_is_left(tmp_path, little_room):
    out = OutputFolder(tmp_path / 'out')
    with pytest.raises(DiskFull, match='cannot be written'), out.filled('calibrate') as folder:
        write_if_possible(None, 'large', lambda: write_text(folder / 'large', LARGE))
    assert not list(tmp_path.iterdir())


SMALL_DISK = """
import json, os, sys
from otf_core.cli import main

code = main(sys.argv[2:])
disk = sys.argv[1]
files = {name: os.path.getsize(f'{disk}/out/{name}') for name in os.listdir(f'{disk}/out')}
print(json.dumps({'code': code, 'files': files, 'beside': os.listdir(disk)}))
print(json.dumps(json.load(open(f'{disk}/out/manifest.json'))))
"""
CELL = Path(__file__).parents[4] / 'bags' / 'y-carries-the-table'


def on_small_disk(folder, size, script, *words):
    """Run a script that finds a file system of so many bytes at a folder, for itself alone."""
    if not shutil.which('unshare'):
        pytest.skip('there is no unshare here')
    mount = f'mount -t tmpfs -o size={size} tmpfs "$0" || exit 77; exec "$@"'
    command = ['unshare', '-rm', 'sh', '-c', mount, str(folder), sys.executable, '-c', script]
    done = subprocess.run([*command, str(folder), *words], capture_output=True, text=True)
    if done.returncode == 77 or 'unshare' in done.stderr:
        pytest.skip(f'no file system can be mounted here: {done.stderr.strip()}')
    assert done.returncode == 0 and 'Traceback' not in done.stderr, done.stderr
    return done


def test_calibration_on_a_disk_that_is_really_full_has_its_tables(tmp_path):
    words = ['calibrate', str(CELL / 'bag'), '--machine', str(CELL / 'machine.yaml')]
    words += ['--out', str(tmp_path / 'out')]
    done = on_small_disk(tmp_path, '420k', SMALL_DISK, *words)
    *said, found, manifest = done.stdout.splitlines()
    found, manifest = json.loads(found), json.loads(manifest)
    first = {'error_tables.json', 'error_tables.csv'}
    assert found['code'] == 0 and found['beside'] == ['out']
    assert set(found['files']) == {*first, MANIFEST} and set(manifest['sha256']) == first
    missing = ['report.html', 'residuals.npz']
    assert manifest['missing'] == dict.fromkeys(missing, 'the disk is full')
    assert 'the disk is full: report.html, residuals.npz not written' in done.stderr
    assert 'open ' not in '\n'.join(said)

# SPDX-License-Identifier: Apache-2.0
"""Results of the calibrator node on a disk that is too small for all of them."""

import json
import subprocess
from pathlib import Path

import pytest
from cells import FAST, SHORT


@pytest.fixture
def small_disk(tmp_path):
    """Mount file systems of so many bytes; they are unmounted at the end."""
    mounted = []

    def mount(size):
        folder = tmp_path / f'disk-{len(mounted)}'
        folder.mkdir()
        words = ['mount', '-t', 'tmpfs', '-o', f'size={size}', 'tmpfs', str(folder)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f'no file system can be mounted here: {done.stderr.strip()}')
        mounted.append(folder)
        return folder

    yield mount
    for folder in mounted:
        subprocess.run(['umount', '-l', str(folder)], check=True)


def test_tables_come_first_and_the_state_names_what_did_not_fit(
    graph, machine_file, small_disk, tmp_path
):
    disk = small_disk('720k')
    given = {'machine_file': machine_file, 'output_directory': disk / 'out'}
    node = graph.start('calibrator', **given, journal_directory=tmp_path / 'journal')
    graph.start('path_planner', machine_file=machine_file, **SHORT)
    more = {**FAST, 'simulated.rate': 200.0, 'time_scale': 20.0}
    graph.start('tracker_driver', machine_file=machine_file, **more)
    result, state = graph.wait_for_result()
    assert (result.status, state.name) == (result.OK, 'DONE')
    graph.wait(lambda: 'samples not written' in graph.state().message, 'what was not saved')
    message = graph.state().message
    assert 'residuals.npz not written' in message and 'report.html' not in message
    folder = Path(result.output_directory)
    assert json.loads((folder / 'error_tables.json').read_text())['run_id'] == result.run_id
    manifest = json.loads((folder / 'manifest.json').read_text())
    first = {'error_tables.json', 'error_tables.csv'}
    assert set(manifest['sha256']) == {*first, 'report.html'}
    full = 'the disk is full'
    assert manifest['missing'] == {'residuals.npz': full, 'samples': full}
    assert {p.name for p in folder.iterdir()} == {*manifest['sha256'], 'manifest.json'}
    assert 'Traceback' not in node.log.read_text()

# SPDX-License-Identifier: Apache-2.0
"""Folders of the calibrator node: each calibration its own, whole; diagnoses leave no mixture."""

import json
import os
from unittest.mock import ANY

import numpy as np
import yaml
from cells import MACHINE

from otf_calibrator import worker as worker_module
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.worker import CalibrationOutput, Diagnosis, Request, Worker, free_folder
from otf_core.config import CalibrationConfig, PlannerConfig, SimulationConfig
from otf_core.errors import InputError
from otf_core.files.writing import DiskFull
from otf_core.history.store import read_store
from otf_core.model.machine import load_machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.pieces.runs import Recording
from otf_core.planning.path_creation import plan_path
from otf_core.sim.cell import simulate


def test_calibrations_of_one_run_get_folders_of_their_own(tmp_path):
    machine_file = tmp_path / 'machine.yaml'
    machine_file.write_text(yaml.safe_dump(MACHINE))
    machine = load_machine(machine_file)
    plan = plan_path(machine, PlannerConfig(passes=1, levels=2))
    samples = simulate(machine, plan, SimulationConfig(rate=50.0)).samples
    files = CalibratorConfig(
        machine_file=str(machine_file),
        output_directory=str(tmp_path / 'out'),
        history_directory=str(tmp_path / 'history'),
    )
    worker = Worker(print)
    request = Request(samples, plan.path, files, CalibrationConfig(), 0)
    outcomes = [worker.start(request).result() for _ in range(2)]
    assert worker.save(outcomes[1]).result().problem == ''
    worker.close()
    assert [o.problem for o in outcomes] == ['', '']
    assert outcomes[0].folder != outcomes[1].folder
    assert (tmp_path / 'out' / 'latest').resolve() == outcomes[1].folder
    for outcome in outcomes:
        assert (outcome.folder / 'manifest.json').exists()
        block = json.loads((outcome.folder / 'error_tables.json').read_text())['provenance']
        assert (block['method'], block['runs'][0]['samples']) == ('otf', len(samples))
    assert (outcomes[1].folder / 'samples' / 'metadata.yaml').exists()
    kept = read_store(tmp_path / 'history').runs
    assert kept[0].content.run_id == outcomes[0].result.run_id
    names = {o.folder.name for o in outcomes}
    assert set(os.listdir(tmp_path / 'out')) == {*names, 'latest'}


def test_all_that_could_not_be_saved_is_named(tmp_path, monkeypatch):
    def full(result, folder, name):
        if name == 'report.html':
            raise DiskFull(f'{folder}: cannot be written (No space left on device)')

    monkeypatch.setattr(worker_module, 'write_later', full)
    (tmp_path / 'samples').write_text('in the way')
    samples = Samples(np.array([1, 2]), np.eye(3)[:2])
    files, path = CalibratorConfig(machine_file='none.yaml'), NominalPath(np.eye(3))
    request = Request(samples, path, files, CalibrationConfig(), 0)
    recording = Recording(samples, path, None, 'samples')
    before, said = 'not added to the history: no', []
    worker = Worker(said.append)
    first = {'error_tables.csv': 'the disk is full'}
    outcome = CalibrationOutput(request, recording, None, tmp_path, before, first)
    saved = worker.save(outcome).result()
    worker.close()
    assert saved.problem == '; '.join([before, *said]) and len(said) == 2
    assert 'report.html not written: ' in said[0] and 'samples not written: ' in said[1]
    missing = json.loads((tmp_path / 'manifest.json').read_text())['missing']
    assert missing == saved.missing == {**first, 'report.html': 'the disk is full', 'samples': ANY}


def test_name_that_is_taken_gets_a_number(tmp_path):
    taken = set()
    for _ in range(50):
        folder = free_folder(tmp_path, 'abc')
        assert not folder.exists()
        folder.mkdir()
        taken.add(folder.name)
    assert len(taken) == 50


def diagnosis_of(tmp_path, monkeypatch, work):
    """Folder and answer of a diagnosis whose process does some work instead."""
    folder, output = tmp_path / 'run', CalibrationOutput
    folder.mkdir(exist_ok=True)
    (folder / 'effects.yaml').write_text('of the diagnosis before')
    (folder / 'calibration_plain').mkdir()
    (folder / 'error_tables.json').write_text('of the calibration')
    monkeypatch.setattr(worker_module.Child, 'do', lambda *given: work(given[2][2]))
    recording = Recording(Samples(np.array([1, 2]), np.eye(3)[:2]), NominalPath(np.eye(3)), None)
    request = Request(recording.samples, recording.path, None, CalibrationConfig(), 0)
    job = Diagnosis(output(request, recording, None, folder), lambda: None)
    job.answer.exception(20.0)
    job.close()
    return {p.name for p in folder.iterdir()}, job.answer


def test_diagnosis_without_a_cause_leaves_none_of_an_earlier_one(tmp_path, monkeypatch):
    names, answer = diagnosis_of(
        tmp_path, monkeypatch, lambda folder: (folder / 'gap.json').write_text('{}')
    )
    assert answer.result() == 2 and names == {'error_tables.json', 'gap.json'}


def test_diagnosis_that_fails_leaves_what_was_there(tmp_path, monkeypatch):
    def fails(folder):
        (folder / 'gap.json').write_text('{}')
        raise InputError('hardly moved')

    names, answer = diagnosis_of(tmp_path, monkeypatch, fails)
    assert answer.exception().exit_code == 3
    assert names == {'error_tables.json', 'effects.yaml', 'calibration_plain'}

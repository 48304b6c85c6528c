# SPDX-License-Identifier: Apache-2.0
"""A defect while files are made or a result is published ends no node and loses no tables."""

import json
import time
from types import SimpleNamespace

import pytest
import rclpy.clock
from cells import write_machine

from otf_calibrator import publish, worker
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.session import Session
from otf_core.config import CalibrationConfig, PlannerConfig, SimulationConfig
from otf_core.files.output_folder import MANIFEST
from otf_core.model.machine import load_machine
from otf_core.planning.path_creation import plan_path
from otf_core.sim.cell import simulate


def fails(*given, **more):
    raise IndexError('tuple index out of range')


@pytest.fixture
def session(tmp_path):
    """A session with a whole run, and what it says."""
    file, said = write_machine(tmp_path), []
    files = CalibratorConfig(machine_file=str(file), output_directory=str(tmp_path / 'out'))
    session = Session(lambda: (files, CalibrationConfig()), said.append)
    machine = load_machine(file)
    plan = plan_path(machine, PlannerConfig(passes=1, levels=2))
    samples = simulate(machine, plan, SimulationConfig(rate=50.0)).samples
    session.collector.set_path(plan.path)
    session.intake.take_samples({'tracker': (samples.stamp_ns, samples.xyz)})
    session.said = said
    yield session
    session.close()


def finished(session):
    """The calibration of the run, and what was saved of it."""
    session.start('requested')
    while not (done := session.take_finished()):
        time.sleep(0.01)
    while not (saved := session.take_saved()):
        time.sleep(0.01)
    return done.result(), saved


def test_report_that_fails_is_named_and_all_other_files_are_there(session, monkeypatch):
    write = worker.write_later

    def write_all_but_the_report(result, folder, name):
        (fails if name == worker.REPORT_FILE else write)(result, folder, name)

    monkeypatch.setattr(worker, 'write_later', write_all_but_the_report)
    done, saved = finished(session)
    assert done.folder and saved.folder == done.folder
    problem = "report.html not written: internal error: IndexError('tuple index out of range')"
    assert saved.problem == problem and problem in session.said
    assert any('Traceback' in text for text in session.said)
    names = {path.name for path in saved.folder.iterdir()}
    assert (
        names >= {'error_tables.json', 'residuals.npz', 'samples'} and 'report.html' not in names
    )
    manifest = json.loads((saved.folder / MANIFEST).read_text())
    assert list(manifest['missing']) == ['report.html']


def test_tables_that_cannot_be_written_are_published(session, monkeypatch):
    monkeypatch.setattr(worker, 'write_calibration', fails)
    done, saved = finished(session)
    assert done.result.run_id and done.folder is None
    assert saved.problem.startswith('files not written: internal error: IndexError')
    assert any('Traceback' in text for text in session.said)


def test_saving_that_fails_as_a_whole_leaves_the_result(session, monkeypatch):
    monkeypatch.setattr(worker, 'written_files', fails)
    done, saved = finished(session)
    assert saved.result is done.result and 'internal error: IndexError' in saved.problem


def test_result_that_cannot_be_published_is_a_failure_that_is_said(session, monkeypatch):
    class Silent:
        """Takes whatever it is told."""

        def __getattr__(self, name):
            return lambda *given, **more: heard.append((name, given))

    heard = []
    outcomes = publish.OutcomePublisher.__new__(publish.OutcomePublisher)
    outcomes._log, outcomes._session, outcomes._state = Silent(), session, Silent()
    outcomes._node, outcomes._unpublished = SimpleNamespace(get_clock=rclpy.clock.Clock), None
    outcomes._tell = lambda message: heard.append(('told', (message.message,)))
    monkeypatch.setattr(outcomes, '_publish', fails)
    session.start('requested')
    while not (done := session.take_finished()):
        time.sleep(0.01)
    outcomes.finish(done)
    assert 'Traceback' in dict(heard)['error'][0]
    assert dict(heard)['failed'][0].startswith('internal error: IndexError')
    outcomes.complete(done.result())
    assert 'done' not in dict(heard)

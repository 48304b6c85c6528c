# SPDX-License-Identifier: Apache-2.0
"""Which samples a run has, whenever somebody looks, and what is lost of it, whoever is killed."""

from concurrent.futures import Future

import numpy as np
import pytest

from otf_calibrator.intake import Status
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.session import Session
from otf_core.bags.bag import read_bag
from otf_core.bags.cdr import encode_path
from otf_core.bags.journal import Journal, state_of
from otf_core.bags.rosbag2_metadata import STATUS
from otf_core.config import CalibrationConfig
from otf_core.model.path import NominalPath
from otf_ros.definitions import message_text

SETTINGS = CalibratorConfig(machine_file='none.yaml'), CalibrationConfig()
PATH = NominalPath(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0]]))
STEP = 2_000_000
"""ns"""
AT_REST = 25
"""Samples of standstill that belong to the run: 0.05 s."""


def driven(*standstills):
    """Stamps and points of the path driven at a millimetre a sample, with stops at 99 % and 100 %.

    Then the target drives back.
    """
    y = np.arange(1, 101)
    for at, count in zip((99, 100), standstills, strict=True):
        y = np.insert(y, int(np.searchsorted(y, at)) + 1, [at] * count)
    y = np.concatenate([y, 100 - np.arange(1, 60)])
    xyz = np.zeros((101 + len(y), 3))
    xyz[:101, 0] = np.arange(101)
    xyz[101:] = np.stack([np.full(len(y), 100), y, 0 * y], axis=1)
    return STEP * np.arange(1, len(xyz) + 1), 1.00001e-3 * xyz + 0.5


def begun(folder):
    """A session with a journal, and what it asks about its samples."""
    session, asked = Session(lambda: SETTINGS, lambda text: None), []

    def look(look, samples):
        asked.append((Future(), len(samples)))
        return asked[-1][0]

    session.worker.look = look
    session.intake.journal = Journal(folder, {})
    return session, asked


def ended(folder, samples, batch, late, ends):
    """Samples of the run and of its journal; it is looked at so many batches later."""
    session, asked = begun(folder)
    session.intake.take_path(PATH, encode_path(PATH.points, 0, 'machine'))
    stamps, xyz = samples
    due = {}
    for number, at in enumerate(range(0, len(stamps) + batch * (late + 2), batch)):
        rows = slice(at, at + batch)
        session.take({'tracker': (stamps[rows], xyz[rows])})
        for verdict, count in asked:
            if due.setdefault(count, number + late) == number:
                verdict.set_result(count in ends)
        session.intake.decide()
        if session.reason_to_end():
            break
    else:
        raise AssertionError('it did not end')
    found = session.request().samples
    session.collector.taken = True
    session.close()
    (journal,) = (p for p in session.intake.journal.directory.iterdir() if p.is_dir())
    return found, read_bag(journal).samples


@pytest.mark.parametrize('late', [0, 1, 4])
@pytest.mark.parametrize('batch', [1, 10, 40, 1000])
def test_end_of_a_run_is_the_same_whenever_it_is_looked_at(tmp_path, batch, late):
    stamps, xyz = samples = driven(0, 160)
    end = 201 + AT_REST
    found, journal = ended(tmp_path, samples, batch, late, [end])
    for side in (found, journal):
        assert side.stamp_ns.tolist() == stamps[:end].tolist()
        assert np.array_equal(side.xyz, xyz[:end])


@pytest.mark.parametrize('late', [0, 1])
@pytest.mark.parametrize('batch', [10, 25, 90])
def test_stop_shortly_before_the_end_is_part_of_the_run(tmp_path, batch, late):
    stamps, _ = samples = driven(140, 300)
    end = 201 + 140 + AT_REST
    found, journal = ended(tmp_path, samples, batch, late, [end])
    assert found.stamp_ns.tolist() == journal.stamp_ns.tolist() == stamps[:end].tolist()


def test_run_that_was_over_when_the_calibrator_was_killed_is_over_when_it_comes_back(tmp_path):
    samples, end = driven(0, 160), 201 + AT_REST
    found, _ = ended(tmp_path, samples, 10, 0, [end])
    session, asked = begun(tmp_path)
    assert f'continues with {end} samples' in session.intake.resume_run(None)
    assert not session.reason_to_end()
    ((verdict, count),) = asked
    verdict.set_result(True)
    assert session.reason_to_end() == 'standstill at the end point' and count == end
    assert session.request().samples.stamp_ns.tolist() == found.stamp_ns.tolist()
    session.close()


TEXTS = {STATUS.type: message_text('otf_msgs', 'TrackerStatus')}


def life(folder, stream, start):
    """A calibrator that takes a run up, hears 100 samples of a stream, and is killed."""
    session = Session(lambda: SETTINGS, lambda text: None)
    session.intake.journal = Journal(folder, TEXTS)

    def status(message):
        return Status(message.decode(), 0, streaming=True, finished=False)

    session.intake.resume_run(status)
    session.intake.take_status(status(stream), stream)
    stamps = STEP * np.arange(start, start + 100)
    session.intake.take_samples({'tracker': (stamps, np.full((100, 3), 0.5))})
    said = session.intake.remarks()
    session.close()
    return said


def test_gaps_of_restarts_are_said_after_the_next_one_as_well(tmp_path):
    first = 'driver or calibrator restarted at stamp 0.198 s: gap of 0.10 s'
    assert life(tmp_path, b'a', 0) == ()
    assert life(tmp_path, b'b', 150) == (first,)
    assert life(tmp_path, b'c', 270) == (
        first,
        first.replace('0.198', '0.498').replace('10', '04'),
    )


def test_run_of_another_machine_yaml_is_kept_and_not_continued(tmp_path):
    file, folder = tmp_path / 'machine.yaml', tmp_path / 'journal'
    stamps, xyz = driven(0, 160)

    def begun_again(said):
        session = Session(lambda: SETTINGS, lambda text: None)
        session.intake.journal = Journal(folder, {}, (), file)
        assert said in session.intake.resume_run(None)
        return session

    file.write_text('table_pitch: 0.03')
    session = begun_again('')
    session.intake.take_path(PATH, encode_path(PATH.points, 0, 'machine'))
    session.intake.take_samples({'tracker': (stamps[:100], xyz[:100])})
    session.close()
    begun_again('continues with 100 samples').close()
    file.write_text('table_pitch: 0.04')
    session = begun_again(f'{file} has changed')
    (run,) = (p for p in folder.iterdir() if p.is_dir())
    (said,) = session.intake.troubles()
    assert f'./otf calibrate {run} --machine MACHINE.yaml' in said
    assert len(session.collector.buffer) == 0
    session.close()
    assert state_of(run) == f'set aside: {file} has changed' and len(read_bag(run).samples) == 100
    begun_again('').close()

# SPDX-License-Identifier: Apache-2.0
"""A calibration begun before the end of a run is known: taken if it is of the run, else not."""

import time
from dataclasses import replace

import pytest
from cells import write_machine

from otf_calibrator.job import Worker
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.request import Request
from otf_core.calibration.calibrate import calibrate
from otf_core.config import CalibrationConfig, PlannerConfig, SimulationConfig
from otf_core.errors import Cancelled
from otf_core.model.machine import load_machine
from otf_core.planning.path_creation import plan_path
from otf_core.sim.cell import simulate
from otf_core.tracking.path_watch import PathWatcher

CONFIG = CalibrationConfig()


@pytest.fixture(scope='module')
def request_made(tmp_path_factory):
    """Request to calibrate a run that is driven to its end."""
    folder = tmp_path_factory.mktemp('cell')
    file = write_machine(folder)
    plan = plan_path(load_machine(file), PlannerConfig(passes=1, levels=2))
    samples = simulate(load_machine(file), plan, SimulationConfig(rate=50.0)).samples
    files = CalibratorConfig(machine_file=str(file), output_directory=str(folder / 'out'))
    return Request(samples, plan.path, files, CONFIG, 0)


@pytest.fixture
def look(request_made):
    return PathWatcher(request_made.path, CONFIG).look


@pytest.fixture
def worker():
    """A worker, and what was given to its solver."""
    worker = Worker(print)
    solve, given = worker._solver.solve, []

    def counted(task, progress):
        given.append(task)
        return solve(task, progress)

    worker._solver.solve, worker.given = counted, given
    yield worker
    worker.close()


def plain(request):
    return calibrate(request.samples, request.path, load_machine(request.files.machine_file))


def test_calibration_begun_early_is_that_of_the_run_bit_by_bit(worker, request_made, look):
    worker.stage = ''
    following = worker.follow(look, request_made)
    assert worker.stage == 'aligning'  # said of what is wanted from now on
    assert following.result()
    found = worker.start(replace(request_made, lost=3)).result()
    assert len(worker.given) == 1 and found.request.lost == 3 and found.folder.exists()
    expected = plain(request_made)
    assert found.result.run_id == expected.run_id
    for name, table in expected.tables.motions.items():
        assert found.result.tables.motions[name].value.tobytes() == table.value.tobytes()


@pytest.mark.parametrize('how', ['samples', 'method', 'remarks'])
def test_another_run_than_that_which_was_begun_gets_its_own(worker, request_made, look, how):
    count = len(request_made.samples)
    changed = {
        'samples': {'samples': request_made.samples.part(0, count - 1)},
        'method': {'files': replace(request_made.files, save_bag=False)},
        'remarks': {'remarks': ('one sample was lost',)},
    }[how]
    assert worker.follow(look, request_made).result()
    request = replace(request_made, **changed)
    found = worker.start(request).result()
    assert len(worker.given) == 2 and found.request is request
    assert found.result.fit.samples == len(request.samples)


def test_calibration_begun_early_is_given_up_when_the_run_goes_on(worker, request_made, look):
    worker.follow(look, request_made)
    worker.give_up()
    following = worker.follow(look, replace(request_made, remarks=('after a pause',)))
    assert following.result()
    assert worker.start(replace(request_made, remarks=('after a pause',))).result().folder
    assert worker.given[-1].recording.remarks[0] == 'after a pause'


def test_calibration_begun_early_can_be_cancelled_once_it_is_that_of_the_run(
    worker, request_made, look
):
    worker.cancel()  # of one before
    assert worker.follow(look, request_made).result()
    job = worker.start(request_made)
    worker.cancel()
    with pytest.raises(Cancelled):
        job.result()
    assert worker.start(request_made).result().folder


def test_run_that_does_not_end_there_is_not_calibrated(worker, request_made, look):
    early = replace(request_made, samples=request_made.samples.part(0, 2000))
    assert not worker.follow(look, early).result()
    worker.ask(lambda samples: time.sleep(0.0), early.samples).result()  # the thread is free again
    assert not worker.given


def test_question_that_fails_is_told(worker, request_made):
    def fails(samples):
        raise ValueError('what is that?')

    with pytest.raises(ValueError, match='what is that'):
        worker.follow(fails, request_made).result()


def test_calibration_of_what_was_driven_gives_way_to_the_end_of_the_run(
    worker, request_made, look
):
    ahead = worker.look_ahead(request_made)
    worker.give_way()
    assert worker.follow(look, request_made).result()
    with pytest.raises(Cancelled):
        ahead.result()

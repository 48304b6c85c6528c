# SPDX-License-Identifier: Apache-2.0
"""Which messages of planner/axes make up a plan, whoever publishes them and however often."""

from pathlib import Path

import numpy as np
import pytest

from otf_calibrator.params import CalibratorConfig
from otf_calibrator.plans import TOGETHER, Plans
from otf_calibrator.session import Session
from otf_core.bags.bag import read_bag
from otf_core.bags.cdr import encode_axes
from otf_core.bags.journal import Journal
from otf_core.config import CalibrationConfig
from otf_core.model.axis_path import AxisPath
from otf_core.model.machine import load_machine
from otf_core.model.path import NominalPath

CELL = Path(__file__).parents[1] / 'bags' / 'trunnion'
TARGETS = ['tool', 'long', 'nest-1', 'nest-2', 'nest-3']
CORNERS = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0]])
LATER = 10 * TOGETHER
SETTINGS = CalibratorConfig(machine_file='none.yaml'), CalibrationConfig()


def part(target, end=0.1):
    return AxisPath(('X', 'C'), np.array([[0.0, 0.0], [end, 1.0]]), target)


A, B, C = (part(name) for name in ('tool', 'nest-1', 'nest-2'))


class Heard:
    """What a calibrator makes of parts."""

    def __init__(self):
        self.heard, self.now = Plans(), 100.0

    def take(self, parts, stamps, driving=False, apart=0.0):
        found = []
        for one, stamp in zip(parts, stamps, strict=True):
            self.now += apart
            found.append(self.heard.take(one, b'', stamp, self.now, driving).name)
        return found

    def targets(self):
        return [one.target for one in self.heard.plan.items]


@pytest.mark.parametrize('stamps', [(1, 1, 1, 1), (1, 2, 3, 4)])
def test_parts_of_one_sending_are_one_plan_even_if_one_comes_twice(stamps):
    plans = Heard()
    assert plans.take([A, B, C, A], stamps) == ['NEW', 'ADDED', 'ADDED', 'ADDED']
    assert plans.targets() == ['tool', 'nest-1', 'nest-2', 'tool']


@pytest.mark.parametrize('driving', [False, True])
def test_plan_of_a_planner_that_was_started_again_is_the_same(driving):
    plans = Heard()
    plans.take([A, B], [1, 1])
    plans.now += LATER
    assert plans.take([A, B], [2, 2], driving) == ['KNOWN', 'KNOWN']
    plans.now += LATER
    assert plans.take([A, B], [3, 3], driving) == ['KNOWN', 'KNOWN'] and len(plans.targets()) == 2


def test_another_plan_is_used_at_once_or_after_the_run():
    plans = Heard()
    plans.take([A, B], [1, 1])
    assert plans.take([A, C], [2, 2]) == ['KNOWN', 'NEW'] and plans.targets() == ['tool', 'nest-2']
    plans.now += LATER
    assert plans.take([part('tool', 0.2), B], [3, 3], driving=True) == ['NEXT', 'NEXT']
    assert plans.targets() == ['tool', 'nest-2']
    assert plans.heard.use_next() and plans.targets() == ['tool', 'nest-1']
    assert not plans.heard.use_next()


def test_parts_that_come_one_by_one_as_they_are_driven_are_one_plan():
    plans = Heard()
    found = plans.take([A], [1]) + plans.take([B, C, A], [2, 3, 4], True, apart=LATER)
    assert found == ['NEW', 'ADDED', 'ADDED', 'ADDED']


def test_bag_that_is_played_again_after_its_run_brings_the_same_plan():
    plans = Heard()
    plans.take([A, B], [1, 1])
    plans.now += LATER
    assert plans.take([A, B], [1, 1]) == ['KNOWN', 'KNOWN']


def test_another_path_in_mid_run_is_kept_for_the_next_run_and_the_newest_counts():
    path, other, plans = NominalPath(CORNERS), NominalPath(CORNERS + 0.1), Heard()
    assert plans.take([path, NominalPath(CORNERS + 1e-9)], [1, 2]) == ['NEW', 'KNOWN']
    assert plans.take([other, other], [3, 3], driving=True) == ['NEXT', 'KNOWN']
    assert plans.heard.plan.items == [path]
    assert plans.heard.use_next() and plans.heard.plan.items == [other]
    assert plans.take([path, other], [4, 5], driving=True) == ['NEXT', 'KNOWN']
    assert not plans.heard.use_next()
    assert plans.take([path], [6]) == ['NEW']


def life(folder, samples):
    """A calibrator that takes up a run and its parts, hears samples, and is killed."""
    session = Session(lambda: SETTINGS, lambda text: None)
    machine = load_machine(CELL / 'machine.yaml')
    session.intake.machine = machine
    session.intake.journal = Journal(folder, {})
    said = session.intake.resume_run(None)
    heard = [
        session.intake.take_path(one, encode_axes(one.axes, one.positions, 7, one.target), 7).name
        for one in read_bag(CELL / 'bag').axis_paths
    ]
    session.take({'tracker': (samples.stamp_ns, samples.xyz)})
    request = session.request()
    targets = [one.target for one in request.path.parts]
    session.close()
    return said, heard, (len(request.samples), targets, request.remarks)


def test_run_of_several_parts_goes_on_after_a_kill_and_its_journal_is_the_bag(tmp_path):
    whole = read_bag(CELL / 'bag')
    count = len(whole.samples)
    half = count // 2
    said, heard, found = life(tmp_path, whole.samples.part(0, half))
    assert not said and heard == ['NEW', *['ADDED'] * 4]
    words = '3 of 5 parts were driven; the others are left out'
    assert found == (half, TARGETS[:3], (words,))
    said, heard, found = life(tmp_path, whole.samples.part(half, count))
    assert f'continues with {half} samples' in said and heard == ['KNOWN'] * 5
    assert found == (count, TARGETS, ())
    (folder,) = (p for p in tmp_path.iterdir() if p.is_dir())
    again = read_bag(folder)
    assert again.samples.xyz.tobytes() == whole.samples.xyz.tobytes()
    assert [one.target for one in again.axis_paths] == TARGETS
    for one, other in zip(again.axis_paths, whole.axis_paths, strict=True):
        assert np.array_equal(one.positions, other.positions)

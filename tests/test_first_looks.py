# SPDX-License-Identifier: Apache-2.0
"""When a run is looked at early: by time or by share, not for ever, and anew for every run."""

from types import SimpleNamespace

import pytest

from otf_calibrator.session import LOOK_EVERY, LOOK_SHARE, MOST_LOOKS, FirstLooks
from otf_core.model.path import NominalPath

PATH = NominalPath([[0, 0, 0], [0.05, 0, 0], [0.1, 0, 0], [0.1, 0.05, 0], [0, 0.05, 0],
                    [0, 0.05, 20], [0, 0, 20], [0, 0, 0.3]])  # fmt: skip
LENGTH = PATH.length


def a_run(travelled, run=1, taken=False):
    """What a collector knows of a run."""
    return SimpleNamespace(path=PATH, taken=taken, travelled=travelled, run=run)


@pytest.fixture
def looks():
    """Of a run whose target has begun to move at time 100 s."""
    looks = FirstLooks()
    assert not looks.is_due(a_run(0.0), 90.0)
    assert not looks.is_due(a_run(0.1), 100.0)
    return looks


def test_looks_after_some_time_or_some_of_the_path_whichever_is_sooner(looks):
    assert not looks.is_due(a_run(0.3), 100.0 + 0.9 * LOOK_EVERY)
    assert looks.is_due(a_run(0.3), 101.0 + LOOK_EVERY)
    assert not looks.is_due(a_run(1.9 * LOOK_SHARE * LENGTH), 102.0 + LOOK_EVERY)
    assert looks.is_due(a_run(2.1 * LOOK_SHARE * LENGTH), 102.0 + LOOK_EVERY)


def test_waits_for_three_legs_however_long_that_takes(looks):
    assert not looks.is_due(a_run(0.24), 5000.0)  # 0.1 m, 0.05 m and 0.1 m
    assert looks.is_due(a_run(0.26), 5000.0)


def test_is_patient_with_the_first_look_only_and_gives_up(looks):
    assert looks.is_due(a_run(0.3), 101.0 + LOOK_EVERY) and looks.patient
    assert looks.is_due(a_run(0.3), 101.0 + 2 * LOOK_EVERY) and not looks.patient
    looks = sum(looks.is_due(a_run(0.3), 101.0 + k * LOOK_EVERY) for k in range(3, 20))
    assert looks == MOST_LOOKS - 2


def test_looks_no_more_once_the_place_is_known_but_at_the_next_run(looks):
    looks.mark_found()
    assert not looks.is_due(a_run(0.9 * LENGTH), 1000.0) and not looks.patient
    assert not looks.is_due(a_run(0.1, run=2), 2000.0)
    assert not looks.is_due(a_run(0.5 * LENGTH, run=2, taken=True), 2001.0)
    assert looks.is_due(a_run(0.5 * LENGTH, run=2), 2001.0)

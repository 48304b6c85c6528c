# SPDX-License-Identifier: Apache-2.0
"""Noise against its specification: just below and above each limit, and how often in error."""

from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import some_machine
from rest_cells import at_rest

from otf_core.diagnosis.engine.gap_sizes import check_noise
from otf_core.noise.departure import (
    HEAVY_TAILS,
    MAX_LEVEL_RATIO,
    SLOW_TIME,
    noise_departure,
)
from otf_core.noise.standstill import noise_model

SPEED = 0.002
SPEC = some_machine().tracker
AS_SPECIFIED = np.array([SPEC.u_range, SPEC.u_angle, SPEC.u_angle])


def departure(stops, seconds, rate, seed, level=AS_SPECIFIED, **noise):
    """What standstills of drawn noise say."""
    return noise_departure(at_rest(stops, seconds, rate, seed, level, **noise), SPEC, SPEED)


@pytest.mark.parametrize('which', range(3))
@pytest.mark.parametrize(('factor', 'named'), [(0.95, False), (1.05, True)])
def test_a_level_is_named_from_its_limit_on(which, factor, named):
    level = AS_SPECIFIED * np.where(np.arange(3) == which, factor * MAX_LEVEL_RATIO, 1.0)
    seen = departure(40, 2.0, 100.0, 10 + which, level, white=(0.9,) * 3, tau=0.1)
    assert seen.loud[which] == named
    assert not np.delete(seen.loud, which).any()


@pytest.mark.parametrize(('factor', 'named'), [(0.75, False), (1.35, True)])
def test_a_correlation_time_is_named_from_its_limit_on(factor, named):
    # 400 s hold 400 times; 1.4 / sqrt(3 * 400) = 4 %, more for stops of 4 s
    seen = departure(100, 4.1, 25.0, 20, white=(0.1,) * 3, tau=factor * SLOW_TIME)
    assert seen.time == pytest.approx(factor * SLOW_TIME, rel=0.25)
    assert seen.slow == named


@pytest.mark.parametrize(('factor', 'named'), [(0.7, True), (1.5, False)])
def test_tails_are_named_from_their_limit_on(factor, named):
    dof = (factor * HEAVY_TAILS,) * 3
    seen = departure(40, 1.0, 200.0, 30, white=(0.9,) * 3, dof=dof)
    assert seen.heavy == named


def test_noise_as_specified_is_hardly_ever_named():
    """Twenty recordings of some sixty stops, none named: less than one in seven (95 %)."""
    for seed in range(20):
        seen = departure(60, 0.5, 100.0, 100 + seed)
        assert not (seen.loud.any() or seen.slow or seen.heavy)


def test_more_standstill_makes_it_surer():
    level = 1.75 * AS_SPECIFIED
    few, many = (departure(n, 1.0, 100.0, 5, level) for n in (32, 250))
    assert many.u_level.max() < 0.5 * few.u_level.max()
    assert few.loud.all() and many.loud.all()
    assert departure(4, 1.0, 100.0, 5, level) is None


def rows_of(samples):
    """What the check needs of one run."""
    machine = some_machine()
    noise = noise_model(samples, machine.tracker, SPEED)
    recording = SimpleNamespace(samples=samples)
    run = SimpleNamespace(recording=recording, machine=machine, noise=noise)
    solved = SimpleNamespace(system=SimpleNamespace(shares=np.ones((3, 2, 5))))
    return SimpleNamespace(observed=[run], done=SimpleNamespace(runs=[solved]))


def test_the_finding_names_the_component_and_carries_its_probability():
    level = AS_SPECIFIED * [1.0, 1.0, 2.5]
    samples = at_rest(40, 1.0, 100.0, 3, level)
    finding = check_noise(rows_of(samples), SPEED)
    seen = noise_departure(samples, SPEC, SPEED)
    ratio, u = seen.level[2], seen.level[2] * seen.u_level[2]
    assert finding.words == (
        f'noise of the vertical angle {ratio:.2f} times as specified (u {u:.2g})'
    )
    assert list(finding.parameters) == ['level_angle']
    assert finding.confidence == seen.probability('level_angle') > 0.99
    worse = (SPEC.u_angle**2 * (seen.level[2] ** 2 - 1)) / (AS_SPECIFIED**2).sum()
    assert finding.variance_ratio == pytest.approx(1.0 + worse, rel=0.01)
    assert check_noise(rows_of(samples), SPEED, ['tracker_noise']) is None
    assert check_noise(rows_of(at_rest(40, 1.0, 100.0, 3, AS_SPECIFIED)), SPEED) is None

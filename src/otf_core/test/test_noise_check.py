# SPDX-License-Identifier: Apache-2.0
"""Noise of the tracker beside its specification: each limit from both sides, in standstills."""

from dataclasses import replace

import numpy as np
import pytest
from engine_cells import solved_rows
from scipy.signal import lfilter

from otf_core.diagnosis.engine import gap_sizes
from otf_core.diagnosis.engine.gap_sizes import check_noise
from otf_core.model.observation import Samples
from otf_core.noise.departure import Departure

RATE, SPEED = 100.0, 0.002


def drawn(rng, count, tau=None, freedom=None):
    """Values (count, 3) of unit variance: white, correlated over tau (s), or of heavy tails."""
    if freedom:
        return rng.standard_t(freedom, (count, 3)) / np.sqrt(freedom / (freedom - 2))
    fresh = rng.standard_normal((count, 3))
    if tau is None:
        return fresh
    memory = np.exp(-1.0 / RATE / tau)
    start = rng.standard_normal((1, 3)) * memory
    return lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], fresh, axis=0, zi=start)[0]


def standing(stops=40, seconds=2.0, level=(1.0, 1.0), seed=1, **colour):
    """Rows whose recordings are stops 20 mm apart, noise ``level`` times as specified."""
    rng, rows = np.random.default_rng(seed), solved_rows()
    spec = rows.runs[0].machine.tracker
    still, move = int(seconds * RATE), 30
    share = np.tile(np.r_[np.zeros(still), np.linspace(0, 1, move)], stops)
    place = 0.02 * (np.repeat(np.arange(stops), still + move) + share)
    noise = drawn(rng, len(place), **colour)
    distance, angles = 0.8 + place, np.array([0.3, 0.2])
    distance = distance + level[0] * spec.u_range * noise[:, 0]
    azimuth = angles[0] + level[1] * spec.u_angle * noise[:, 1] / np.cos(angles[1])
    elevation = angles[1] + level[1] * spec.u_angle * noise[:, 2]
    flat = distance * np.cos(elevation)
    xyz = np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1
    )
    stamp = (np.arange(len(xyz)) * 1e9 / RATE).astype(np.int64)
    samples = Samples(stamp, xyz)
    runs = tuple(replace(r, samples=samples) for r in rows.runs)
    return replace(rows, observed=runs, runs=runs)


def found(**stops):
    return check_noise(standing(**stops), SPEED)


NAMES = {'level_range': 'noise of the range', 'level_angle': 'angle'}


def test_noise_as_specified_is_no_finding():
    assert found() is None


@pytest.mark.parametrize(
    ('level', 'keys'),
    [
        ((1.55, 1.55), set()),
        ((1.65, 1.55), {'level_range'}),
        ((1.55, 1.65), {'level_angle'}),
        ((3.0, 3.0), {'level_range', 'level_angle'}),
        ((0.3, 0.3), set()),
    ],
)
def test_level_is_found_from_a_factor_of_1_6_on(level, keys):
    """8000 samples tell a level to 1 %."""
    finding = found(level=level)
    assert set(finding.parameters if finding else ()) == keys
    if finding:
        for key, true in zip(('level_range', 'level_angle'), level, strict=True):
            assert finding.parameters.get(key, true) == pytest.approx(true, rel=0.03)
            assert (NAMES[key] in finding.words) is (key in keys)


@pytest.mark.parametrize(('tau', 'slow'), [(0.3, False), (0.6, False), (1.7, True)])
def test_correlation_is_found_beyond_a_second(tau, slow):
    """Stops of 4 s tell the time to some 20 %."""
    finding = found(stops=50, seconds=4.0, tau=tau)
    assert bool(finding and 'correlation_time' in finding.parameters) is slow
    if slow:
        assert finding.parameters['correlation_time'] > 1.0
        assert 'correlated over' in finding.words


@pytest.mark.parametrize(('freedom', 'heavy'), [(2.5, True), (3.0, True), (6.0, False)])
def test_tails_are_heavy_below_five_degrees_of_freedom_of_differences(freedom, heavy):
    """Differences of two samples have lighter tails than one: 3 become some 3.9, 5 some 7."""
    finding = found(stops=60, freedom=freedom)
    assert bool(finding and 'dof' in finding.parameters) is heavy
    if heavy:
        assert 2.2 <= finding.parameters['dof'] < 5.0
        assert 'heavy tails' in finding.words


@pytest.mark.parametrize(
    ('stops', 'seconds', 'judged'), [(2, 2.0, False), (2, 3.0, True), (29, 0.5, True)]
)
def test_five_seconds_of_standstill_are_needed_however_many_stops(stops, seconds, judged):
    for case in ({'level': (4.0, 4.0)}, {'freedom': 3.0, 'level': (4.0, 4.0)}):
        finding = found(stops=stops, seconds=seconds, **case)
        assert (finding is not None) is judged
        assert not judged or 'level_range' in finding.parameters


@pytest.mark.parametrize('seed', range(4))
def test_noise_as_specified_is_no_finding_in_two_stops(seed):
    assert found(stops=2, seconds=3.0, seed=seed, tau=0.3) is None


def test_effect_that_is_excluded_is_not_found():
    assert check_noise(standing(level=(3.0, 3.0)), SPEED, ['tracker_noise']) is None


def test_words_are_said_once_for_all_runs():
    finding = found(level=(3.0, 1.0))
    assert finding.words.count('noise of the range') == 1


@pytest.mark.parametrize(('u', 'named'), [(0.1, False), (0.08, True)])
def test_slow_noise_makes_no_gap_and_is_named_only_when_sure(monkeypatch, u, named):
    seen = Departure(np.ones(3), np.full(3, 0.1), 1.2, u, 9.0, 100.0, 0.0)
    monkeypatch.setattr(gap_sizes, 'noise_departure', lambda *given: seen)
    for gap in (False, True):
        finding = check_noise(solved_rows(), SPEED, gap=gap)
        assert (finding is not None) == named
        assert not named or set(finding.parameters) == {'correlation_time'}

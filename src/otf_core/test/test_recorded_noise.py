# SPDX-License-Identifier: Apache-2.0
"""What recordings of real trackers hold, and whether the simulated tracker looks like them."""

from pathlib import Path

import numpy as np
import pytest
from core_cells import START_NS, some_machine

from otf_core.model.observation import Samples
from otf_core.noise.noise_model import NoiseModel
from otf_core.noise.report import noise_report
from otf_core.reports.noise_report import format_noise
from otf_core.sim.tracker import measure

DATA = Path(__file__).parent / 'data'
SPEED = 0.002


def reflector_points():
    """Distance (m) and standard deviations along and across the beam (um) of every point.

    The files give positions in a frame of the room. The beam is the direction in which a point
    scatters least; the beams of one session meet in the tracker. By session.
    """
    rows = [line.split(',') for line in (DATA / 'reflector_points.csv').read_text().splitlines()]
    sessions = {}
    for name in dict.fromkeys(row[0] for row in rows[3:]):
        values = np.array([row[1:] for row in rows[3:] if row[0] == name], dtype=float)
        place = values[:, :3]
        covariance = np.zeros((len(values), 3, 3))
        for k in range(3):
            covariance[:, k, k] = values[:, 3 + k] ** 2
        for column, (i, j) in enumerate(((0, 1), (0, 2), (1, 2)), start=6):
            covariance[:, i, j] = covariance[:, j, i] = values[:, column]
        variance, axes = np.linalg.eigh(covariance)
        beam = axes[:, :, 0]
        across = np.eye(3) - beam[:, :, None] * beam[:, None, :]
        off = np.zeros(len(place))
        for _ in range(15):  # some points have no clear direction
            used = across[off <= max(2 * np.median(off), 1e-6)]
            ends = place[off <= max(2 * np.median(off), 1e-6)]
            station = np.linalg.solve(used.sum(0), np.einsum('nij,nj->i', used, ends))
            ray = place - station
            distance = np.linalg.norm(ray, axis=1)
            off = np.degrees(np.arccos(np.minimum(1, np.abs(np.sum(ray * beam, 1)) / distance)))
        along = np.sqrt(np.maximum(variance[:, 0], 0))
        sigma = np.sqrt(0.5 * variance[:, 1:].sum(axis=1))
        sessions[name] = (1e-3 * distance, 1e3 * along, 1e3 * sigma, off)
    return sessions


SESSIONS = reflector_points()


def growth(distance, across):
    """Exponent of the distance in the median level across the beam, by bins of distance."""
    edges = np.quantile(distance, np.linspace(0, 1, 7))
    group = np.clip(np.searchsorted(edges, distance, side='right') - 1, 0, 5)
    middle = [np.log(np.median(distance[group == g])) for g in range(6)]
    level = [np.log(np.median(across[group == g])) for g in range(6)]
    return np.polyfit(middle, level, 1)[0]


def test_angle_level_repeats_from_session_to_session():
    level = [np.median(across / distance) for distance, _, across, _ in SESSIONS.values()]
    assert min(level) > 0.8 and max(level) < 1.6  # urad
    assert max(level) / min(level) < 1.7


def test_range_is_far_quieter_than_the_points_across_the_beam():
    along = np.concatenate([s[1] for s in SESSIONS.values()])
    across = np.concatenate([s[2] for s in SESSIONS.values()])
    assert 0.05 < np.median(along) < 0.4  # um
    assert np.median(across) > 10 * np.median(along)


def test_noise_across_the_beam_grows_with_distance_as_the_simulated_one():
    distance = np.concatenate([s[0] for s in SESSIONS.values()])
    across = np.concatenate([s[2] for s in SESSIONS.values()])
    simulated = []
    rng, noise = np.random.default_rng(5), NoiseModel.from_spec(some_machine().tracker)
    for length in distance:
        true = np.tile([0.6 * length, 0.7 * length, 0.39 * length], (50, 1))
        noisy = measure(true, noise, 100.0, rng)
        variance = np.linalg.eigvalsh(np.cov(noisy.T))
        simulated.append(1e6 * np.sqrt(0.5 * variance[1:].sum()))
    assert growth(distance, across) == pytest.approx(1.0, abs=0.2)
    assert growth(distance, np.array(simulated)) == pytest.approx(1.0, abs=0.2)


@pytest.fixture(scope='module')
def cart():
    """Stream of a hand-driven cart over a network: never at rest, with pauses."""
    rows = np.loadtxt(DATA / 'cart_stream.csv', delimiter=',', skiprows=3)
    stamp_ns = START_NS + np.rint(1e9 * rows[:, 0]).astype(np.int64)
    return noise_report(Samples(stamp_ns, 1e-3 * rows[:, 1:]), SPEED)


def test_lost_samples_of_a_recorded_stream_are_told(cart):
    assert (cart.lost.samples, cart.lost.gaps) == (169, 3)
    assert cart.lost.longest == pytest.approx(2.70, abs=0.01)
    assert 'WARNING 169 samples lost in 3 gaps (7 %), the longest 2.70 s' in format_noise(
        cart.to_dict()
    )

# SPDX-License-Identifier: Apache-2.0
"""One noise model from standstills to weights: nothing of its three components is lost."""

import json
from dataclasses import replace

import numpy as np
import pytest
from core_cells import some_machine, transform_pose
from nature_tracker import beam_frame
from rest_cells import at_rest, spoiled

from otf_core.errors import ConfigError
from otf_core.model.machine import TrackerSpec
from otf_core.noise.noise_model import (
    NoiseComponent,
    NoiseModel,
    beam_shares,
    noise_from_fields,
    noise_to_fields,
    read_noise,
    sample_variance,
)
from otf_core.noise.report import noise_report
from otf_core.noise.standstill import find_standstills, noise_model, standstill_noise
from otf_core.reports.pages import write_document
from otf_core.sim.tracker import measure

SPEED = 0.002
LEVEL, WHITE, DOF = (0.4e-6, 1.0e-6, 3.0e-6), (0.9, 0.3, 0.6), (None, None, 4.0)
MODEL = NoiseModel(
    NoiseComponent(4e-7, 3e-7, 0.1),
    NoiseComponent(1.1e-6, 7e-7, 0.4, 3.5),
    NoiseComponent(3.3e-6, 3.3e-6, 0.0),
)


@pytest.fixture(scope='module')
def rest():
    """Eighty seconds at rest in twenty stops."""
    return at_rest(20, 4.0, 250.0, 1, LEVEL, white=WHITE, tau=0.2, dof=DOF)


def test_components_that_were_drawn_come_back(rest):
    noise = standstill_noise(rest, find_standstills(rest, SPEED)).noise
    # slow noise of 0.2 s in 80 s: 400 independent squares, 3.5 % of a level, less for what is
    # white; the fit splits the parts to about as much: 4 standard deviations
    np.testing.assert_allclose(noise.level, LEVEL, rtol=0.14)
    np.testing.assert_allclose([c.white_share for c in noise], WHITE, rtol=0.14)
    # five seconds tell 0.2 s to 25 % (docs/uncertainty.md), so three components of 80 s to 4 %
    assert noise.range.correlation_time == pytest.approx(0.2, rel=0.16)
    assert [c.dof is None for c in noise] == [True, True, False]
    # the slow rest beside the white part makes tails look lighter
    assert 3.0 < noise.vertical.dof < 7.0


def test_a_run_keeps_its_two_angles_apart(rest):
    found = noise_model(rest, TrackerSpec(0.5e-6, 0.9e-6), SPEED)
    assert found.range.level == 0.5e-6  # within the factor that passes
    assert found.horizontal.level == 0.9e-6
    assert found.vertical.level == pytest.approx(3e-6, rel=0.14)
    assert found.vertical.dof is not None


def test_what_contradicts_the_specification_keeps_its_own_colour():
    samples = at_rest(60, 1.0, 100.0, 2, (1.5e-6, 2.6e-6, 2.6e-6), tau=0.2)
    measured = standstill_noise(samples, find_standstills(samples, SPEED)).noise
    found = noise_model(samples, TrackerSpec(0.5e-6, 2e-6), SPEED)
    assert found.range == measured.range
    # variance over time of the slow part of both angles together stays, at the specified level
    assert found.horizontal.level == found.vertical.level == 2e-6
    ratio = [
        sum(c.slow**2 for c in (n.horizontal, n.vertical)) / n.vertical.correlation_time
        for n in (found, measured)
    ]
    assert ratio[0] == pytest.approx(ratio[1], rel=1e-6)


def seen(off, xyz):
    """Range and both angles of the offsets (n, 3) of points."""
    reach = np.linalg.norm(xyz, axis=1)
    return [np.sum(off * d, 1) / (reach if k else 1.0) for k, d in enumerate(beam_frame(xyz))]


def assert_drawn_from(noise, series, rate):
    """Level, correlation after a fifth of a second, and tails of three series."""
    lag = round(0.2 * rate)
    for part, values in zip(noise, series, strict=True):
        # a thousand times the correlation time: 2.2 % of a level, 4.5 % of a correlation; 4 of it
        assert values.std() == pytest.approx(part.level, rel=0.1)
        slow = 1.0 - part.white_share
        expected = slow * np.exp(-0.2 / part.correlation_time) if slow else 0.0
        assert np.mean(values[lag:] * values[:-lag]) / values.var() == pytest.approx(
            expected, abs=0.1
        )
        far = np.mean(np.abs(values) > 5.0 * values.std())
        assert (far > 2e-5) == (part.dof is not None)  # 6e-7 for normal noise


def test_the_simulated_tracker_has_every_component():
    model = NoiseModel(MODEL.range, MODEL.horizontal, replace(MODEL.vertical, dof=3.0))
    xyz = np.tile([0.5, -0.8, 0.3], (100_000, 1))
    off = measure(xyz, model, 250.0, np.random.default_rng(4)) - xyz
    # the second direction of the test's own frame points the other way round: levels only count
    assert_drawn_from(model, seen(off, xyz), 250.0)


def test_noise_json_is_read_as_it_was_written(rest, tmp_path):
    assert noise_from_fields(json.loads(json.dumps(noise_to_fields(MODEL)))) == MODEL
    report = noise_report(rest, SPEED)
    write_document(report, tmp_path)
    assert read_noise(tmp_path / 'noise.json') == report.noise
    data = json.loads((tmp_path / 'noise.json').read_text())
    assert noise_to_fields(read_noise(tmp_path / 'noise.json')).keys() <= data.keys()
    for key in ('u_range', 'u_angle', 'white_range', 'white_angle', 'correlation_time'):
        assert noise_to_fields(read_noise(tmp_path / 'noise.json'))[key] == data[key]


@pytest.mark.parametrize(
    ('changed', 'message'),
    [
        ({'u_angle': [1e-6]}, 'two values each'),
        ({'white_range': 5e-7}, 'between 0 and the level'),
        ({'correlation_time': 0.0}, 'is 0 beside a slow part'),
        ({'correlation_time': [0.1, 0.2]}, 'one value, or three'),
        ({'tails': {'range': {'student_freedom': 1.0}}}, 'must be above 2'),
        ({'tails': [4.0]}, 'no attribute'),
        ({'u_range': float('nan')}, 'levels must be above 0'),
    ],
)
def test_impossible_noise_is_refused(tmp_path, changed, message):
    file = tmp_path / 'noise.json'
    file.write_text(json.dumps(noise_to_fields(MODEL) | changed))
    with pytest.raises(ConfigError, match=rf'noise\.json: not a noise\.json .*{message}'):
        read_noise(file)


def test_variance_of_rows_follows_the_direction_of_the_worse_angle():
    machine = some_machine()
    pose = transform_pose(machine, 2)
    rng = np.random.default_rng(6)
    place = rng.uniform(0.2, 1, 3)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    n = 40_000
    off = spoiled(np.tile(place, (n, 1)), 100.0, rng, LEVEL, white=(1.0, 1.0, 1.0)) - place
    drawn = np.var(pose.rotate(off) @ axes.T, axis=0)
    parts = (NoiseComponent(u, u) for u in LEVEL)
    found = sample_variance(NoiseModel(*parts), beam_shares(place[None], pose, axes[:, None]))
    # the variance of n values has the relative standard deviation sqrt(2 / n) = 0.7 %; 5 of them
    np.testing.assert_allclose(drawn, found[:, 0], rtol=0.036)

# SPDX-License-Identifier: Apache-2.0
"""Where a gap lies, on plain arrays with a known structure in them."""

import re
from dataclasses import replace

import numpy as np
import pytest
from gap_cells import NOISE, SIZE, along, run_view, where_of

from otf_core.diagnosis.place.groups import (
    as_waves,
    by_feed,
    by_line,
    by_region,
    by_time,
    normal_score,
    partition,
)
from otf_core.diagnosis.place.structure import find_structures
from otf_core.diagnosis.place.where import Where, describe_structure, where_and_shape

LISTS = (
    'by_time',
    'by_path_piece',
    'by_axis_and_direction',
    'by_region',
    'by_beam',
    'by_frequency',
)


def sense(view, axis):
    return np.sign(np.where(np.abs(view.direction[:, axis]) > 0.05, view.direction[:, axis], 0.0))


def wave(view, axis, period):
    """Means over pieces of 8 mm of a wave along an axis."""
    weak = np.sinc(0.008 * view.direction[:, axis] / period)
    return weak * np.sin(2 * np.pi * view.q[:, axis] / period)


def small(gap, **further):
    return run_view(gap, laps=2, feed=0.25, **further)


def row(rows, label):
    return next(r for r in rows if r['label'] == label)


@pytest.mark.parametrize(
    ('gap', 'words'),
    [
        (lambda v: along(2, 3e-6 * (v.time >= 100)), ('since ', 'step of', 'along machine +Z')),
        (lambda v: along(1, -0.9e-6 / 60 * v.time), ('drift of ', 'um/min along machine -Y')),
        (
            lambda v: along(0, 5e-6 * (1 - np.exp(-v.time / 40))),
            ('drift to ', 'along machine +X that settles'),
        ),
        (lambda v: along(0, 1.5e-6 * wave(v, 0, 0.02)), ('period 20.', 'axis X', 'along X')),
        (
            lambda v: along(2, 1.2e-6 * sense(v, 0)),
            ('sense of travel of X: 1.2 um along machine +Z forward',),
        ),
        (
            lambda v: along(2, 8e-6 * v.speed * v.direction[:, 1]),
            ('sense of travel of Y', 'grows with its feed', '0.8'),
        ),
        (
            lambda v: along(0, 2e-6 * np.sin(2 * np.pi * v.time / 60)),
            ('period ', ' s, amplitude ', ' um along X'),
        ),
        (lambda v: along(1, 4e-6 * (v.q > 0.66 * SIZE).all(axis=1)), ('X high, Y high, Z high',)),
        (
            lambda v: along(2, 4e-6 * np.sin(2 * np.pi * 6 * v.time)),
            ('mostly at 4 Hz to 8 Hz',),
        ),
    ],
    ids=['step', 'drift', 'settling', 'wave', 'sense', 'feed', 'slow wave', 'region', 'vibration'],
)  # fmt: skip
def test_structure_is_described(gap, words):
    text = describe_structure([small(gap)])
    assert all(word in text for word in words), text


def step_size(views, project=None):
    text = describe_structure(views, project=project)
    return float(re.match(r'since \d+ s, step of ([\d.]+) um along machine \+Z', text).group(1))


@pytest.mark.parametrize('start', [60.0, 140.0, 200.0])
def test_moment_and_size_of_a_step_are_found(start):
    view = small(lambda v: along(2, 3.1e-6 * (v.time >= start)))
    moment, size = re.match(
        r'since (\d+) s, step of ([\d.]+) um', describe_structure([view])
    ).groups()
    unseen = max(view.time[high - 1] - view.time[low] for low, high in view.bounds)  # along Z
    assert float(moment) == pytest.approx(start, abs=unseen + 1.0)
    assert float(size) == pytest.approx(3.1, abs=0.25)


@pytest.mark.parametrize('period', [20.0, 60.0, 85.0])
def test_period_of_a_slow_wave_is_found(period):
    text = describe_structure(
        [small(lambda v: along(0, 2e-6 * np.sin(2 * np.pi * v.time / period)))]
    )
    assert float(re.match(r'period ([\d.]+) s', text).group(1)) == pytest.approx(period, rel=0.02)


def test_far_from_the_tracker_is_said():
    def gap(view):
        far = np.linalg.norm(view.beam, axis=1) > 1.3
        flip = np.where(view.leg % 2 > 0, 1.0, -1.0)
        return far[:, None] * flip[:, None] * 2e-6 * np.array([0.6, 0.6, 0.5])

    assert 'larger far from the tracker' in describe_structure([small(gap)])


def test_two_structures_are_found_the_larger_first():
    view = small(lambda v: along(2, 3e-6 * (v.time >= 100)) + along(0, 1.5e-6 * wave(v, 1, 0.03)))
    found = find_structures([view])
    assert [s.family for s in found[:2]] == ['step', 'wave Y']
    assert found[0].share > found[1].share > 0.1
    assert 'period 30.' in found[1].words


def test_sizes_of_two_structures_are_those_of_a_joint_fit():
    view = small(lambda v: along(0, 2e-6 * sense(v, 0)) + along(2, -1.5e-6 * sense(v, 2)))
    text = describe_structure([view])
    sizes = dict(re.findall(r'travel of (\w): ([\d.]+) um', text))
    assert float(sizes['X']) == pytest.approx(2.0, abs=0.15)
    assert float(sizes['Z']) == pytest.approx(1.5, abs=0.15)
    assert 'along machine +X forward' in text
    assert 'along machine -Z forward' in text


@pytest.mark.parametrize('seed', range(4))
def test_noise_alone_has_no_structure(seed):
    where, shape = where_and_shape([small(None, seed=seed)])
    assert shape == 'no structure beyond noise'
    assert 'No place stands out' in where.summary


def test_all_lists_are_plain_data_with_the_agreed_keys():
    where = where_of([small(lambda v: along(2, 3e-6 * (v.time >= 100)))])
    for name in LISTS:
        rows = getattr(where, name)
        assert rows, name
        for entry in rows:
            assert {'label', 'rms_um', 'expected_um', 'significance'} <= set(entry)
            assert all(isinstance(v, (str, int, float, list)) for v in entry.values())
    assert isinstance(where, Where)


def test_step_is_significant_after_it_and_not_before():
    view = small(lambda v: along(2, 3e-6 * (v.time >= 120)))
    rows = where_of([view]).by_time
    starts = np.linspace(view.time.min(), view.time.max(), len(rows) + 1)
    before = [r for r, end in zip(rows, starts[1:], strict=True) if end < 120]
    after = [r for r, start in zip(rows, starts, strict=False) if start > 120]
    assert len(before) > 3 < len(after)
    assert max(r['significance'] for r in before) < 4
    assert np.median([r['significance'] for r in after]) > 5
    assert np.median([r['rms_um'] for r in after]) > 2 > 1 > rows[0]['rms_um']


def test_gap_points_along_the_axis_of_the_displacement():
    rows = where_of([small(lambda v: along(1, 3e-6 * (v.time >= 100)))]).by_axis_and_direction
    gaps = {r['label']: r['rms_um'] for r in rows if r['kind'] == 'points'}
    assert gaps['along machine Y'] > 2 * max(gaps['along machine X'], gaps['along machine Z'])


def test_error_of_one_sense_of_travel_shows_on_those_lines():
    rows = where_of([small(lambda v: along(2, 3e-6 * (sense(v, 0) > 0)))]).by_axis_and_direction
    assert row(rows, '+X')['significance'] > 10 > 4 > abs(row(rows, '-X')['significance'])
    assert row(rows, 'X forward')['rms_um'] > 2 * row(rows, 'X backward')['rms_um']


def test_bands_hold_all_of_the_residual():
    view = small(lambda v: along(0, 2e-6 * wave(v, 1, 0.06)))
    where = where_of([view])
    bands = [r for r in where.by_frequency if r['kind'] == 'frequency']
    square = sum(r['rms_um'] ** 2 * r['pieces'] for r in bands) / max(r['pieces'] for r in bands)
    assert square == pytest.approx(1e12 * (view.residual_before**2).sum(axis=0).mean(), rel=0.02)
    peak = max(
        (r for r in where.by_frequency if r['kind'] == 'waves along Y'),
        key=lambda r: r['significance'],
    )
    assert peak['label'] == 'Y: 50 mm to 100 mm'


def test_significance_of_correlated_noise_is_about_normal():
    scores = []
    for seed in range(6):
        view = small(None, seed=20 + seed)
        for grouping in (by_time([view]), by_line([view]), by_region([view]), by_feed([view])):
            [groups] = partition([view], [grouping])
            scores += [g.significance for g in groups]
    assert np.mean(scores) == pytest.approx(0.0, abs=0.3)
    assert 0.6 < np.std(scores) < 1.25
    assert max(scores) < 4.5


def test_twice_the_noise_is_significant():
    groups = where_of([small(None, noise=2 * NOISE)]).by_time
    assert min(r['significance'] for r in groups) > 4


def test_score_of_a_sum_of_squares_is_that_of_a_normal_quantity():
    # 10 degrees of freedom: 18.307 is exceeded in 5 % of the cases, 29.588 in 0.1 %
    assert normal_score(18.307, 10.0, 20.0) == pytest.approx(1.645, abs=0.01)
    assert normal_score(29.588, 10.0, 20.0) == pytest.approx(3.090, abs=0.03)


def test_runs_are_told_apart():
    views = [
        small(None, name='first'),
        small(lambda v: along(2, 3e-6 * (v.time >= 100)), seed=5, name='second'),
    ]
    where = where_of(views)
    assert 'in second, step of' in where.summary
    times = where.by_time
    assert {r['label'].split(':')[0] for r in times} == {'first', 'second'}
    assert max(times, key=lambda r: r['significance'])['label'].startswith('second')


def test_size_is_true_where_pose_has_taken_its_part():
    plain = small(lambda v: along(2, 3e-6 * (v.time >= 100)))
    turns = [np.cross(np.eye(3)[k], plain.q) for k in range(3)]
    columns = [plain.axes, np.einsum('cpi,kpi->cpk', plain.axes, np.array(turns))]
    white = plain.whiten(np.concatenate(columns, axis=2))
    basis = np.linalg.qr(white)[0]

    def project(wide):
        return wide - basis @ (basis.T @ wide)

    left = plain.whitener.unwhiten(
        project(plain.whiten(plain.residual_before[:, :, None])).reshape(plain.expected.shape)
    )
    view = replace(plain, residual_before=left)
    assert step_size([view], project) == pytest.approx(3.0, abs=0.2)


def test_what_the_causes_leave_can_be_looked_at():
    view = small(lambda v: along(2, 5e-6 * (v.time >= 100)), after=lambda v: 0.0 * v.q)
    assert 'step' in describe_structure([view])
    where, shape = where_and_shape([view], 'residual_after')
    assert shape == 'no structure beyond noise' and 'No place stands out' in where.summary


@pytest.mark.parametrize('count', [6, 7, 31])
def test_waves_of_a_leg_are_an_orthonormal_basis_of_whole_cycles(count):
    turned = as_waves(np.eye(count)).T  # one wave per row
    np.testing.assert_allclose(turned @ turned.T, np.eye(count), atol=1e-12)
    for row, wave_of_leg in enumerate(turned):
        power = np.abs(np.fft.rfft(wave_of_leg)) ** 2
        assert np.argmax(power) == (row + 1) // 2
        assert power.max() > (1 - 1e-12) * power.sum()

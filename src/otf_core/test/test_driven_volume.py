# SPDX-License-Identifier: Apache-2.0
"""The driven volume: ranges of the axes, hulls that are flat or not, what a file says of it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from core_cells import some_machine, written_tables, zero_tables

from otf_core.errors import InputError
from otf_core.model.evaluation import lattice
from otf_core.model.tables import MotionTable
from otf_core.prediction.driven_volume import DrivenVolume, driven_volume, table_ranges
from otf_core.prediction.predict import predict


def test_range_of_an_axis_is_what_its_seen_tables_share():
    base = zero_tables(some_machine())
    short = MotionTable(np.array([0.05, 0.2]), np.zeros(2), np.zeros(2))
    unseen = replace(short, position=np.array([0.1, 0.12]), identifiable=False)
    tables = replace(base, motions={**base.motions, 'EYX': short, 'EAX': unseen})
    low, high = table_ranges(tables)
    np.testing.assert_array_equal(low, [0.05, 0.0, -0.2])
    np.testing.assert_array_equal(high, [0.2, 0.25, 0.0])


def test_hull_of_points_keeps_its_corners_and_knows_what_is_inside():
    rng = np.random.default_rng(1)
    corners = lattice(some_machine(), 2)
    centre = corners.mean(axis=0)
    cloud = np.concatenate([corners, centre + 0.9 * rng.uniform(-0.5, 0.5, (500, 3)) * 0.2])
    volume = driven_volume(cloud, 0.0)
    assert len(volume.corners) == 8
    assert volume.holds(np.array([[0.01, 0.01, -0.01], [0.31, 0.1, -0.1]])).tolist() == [
        True,
        False,
    ]
    cut = driven_volume(corners[:-1], 0.01)  # without the corner at the upper ends
    probes = np.array([[0.29, 0.24, -0.01], [0.1, 0.1, -0.1], [0.0, 0.25, 0.0], [0.0, 0.0, 0.0]])
    assert cut.holds(probes).tolist() == [False, True, True, True]


@pytest.mark.parametrize('size', [0, 1, 2])
def test_flat_volumes_hold_what_lies_in_them(size):
    rng = np.random.default_rng(size)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0][:size]
    points = np.array([0.1, 0.2, 0.3]) + rng.uniform(-0.2, 0.2, (40, size)) @ axes
    volume = driven_volume(points, 0.005)
    assert np.all(volume.holds(points))
    normal = np.linalg.qr(np.vstack([axes, rng.standard_normal((3 - size, 3))]).T)[0].T[size]
    assert not np.any(volume.holds(points + 0.01 * normal))
    assert np.all(volume.holds(points + 0.004 * normal))
    if size:
        assert not np.any(volume.holds(points + 0.5 * axes[0]))


@pytest.mark.parametrize(
    'driven',
    [3, {'margin': 0.1}, {'corners': [[0, 0]]}, {'corners': [[0, 0, None]]},
     {'corners': [[0, 0, 0]], 'margin': -1}, {'corners': 'cube'},
     {'corners': [[0, 0, 0]], 'planes': [[1, 0, 0]]}],
)  # fmt: skip
def test_a_wrong_driven_volume_is_named(driven):
    with pytest.raises(InputError, match=r'tables\.json: driven'):
        DrivenVolume.from_dict(driven, 'tables.json: driven')


def test_a_driven_volume_in_the_file_counts_beside_the_tables(tmp_path):
    tables = zero_tables(some_machine())
    corners = lattice(tables.machine, 2)[:-1]
    q = np.array([[0.1, 0.1, -0.1], [0.29, 0.24, -0.01]])
    assert predict(written_tables(tmp_path, tables), q).inside.tolist() == [True, True]
    for prism in (
        {'corners': corners.tolist(), 'margin': 0.01},
        driven_volume(corners, 0.01).to_dict(),
    ):
        file = written_tables(tmp_path, tables, driven=prism)
        assert predict(file, q).inside.tolist() == [True, False]


def test_planes_in_the_file_say_the_same_as_its_corners():
    rng = np.random.default_rng(2)
    volume = driven_volume(rng.normal(size=(60, 3)), 0.01)
    data = volume.to_dict()
    planes = np.array(data.pop('planes'))
    assert len(planes) > 10
    np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0)
    touched = np.abs(volume.corners @ planes[:, :3].T + planes[:, 3]) < 1e-12
    assert np.all(touched.sum(axis=0) >= 3) and np.all(touched.sum(axis=1) >= 3)
    probes = 1.2 * rng.normal(size=(5000, 3))
    of_corners = DrivenVolume.from_dict(data).holds(probes)
    np.testing.assert_array_equal(volume.holds(probes), of_corners)
    assert 0.2 < of_corners.mean() < 0.9


def test_a_calibration_writes_what_was_driven(calibrated, cell, tmp_path):
    file = tmp_path / 'error_tables.json'
    file.write_text(json.dumps(calibrated.to_dict()))
    q = lattice(cell.machine, 5)
    found = predict(file, np.concatenate([q, np.add(q, [0.02, 0, 0])]))
    assert found.inside[: len(q)].all()
    assert found.inside[len(q) :].sum() == 100
    assert 'u holds noise, misfit; systematic contributions typical' in found.summary

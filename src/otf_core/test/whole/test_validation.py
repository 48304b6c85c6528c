# SPDX-License-Identifier: Apache-2.0
"""The paper's comparisons, on a small scale."""

import json

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.config import SimulationConfig
from otf_core.reports.validation import write_validation
from otf_core.sim.laboratory import SimulatedLaboratory
from otf_core.validation.paper import (
    Scale,
    across_path,
    calibration_points,
    paper_machine,
    reference_points,
    scale,
)
from otf_core.validation.validate import Row, format_rows, validate

FAST = 0.25


@pytest.fixture(scope='module')
def laboratory():
    return SimulatedLaboratory(SimulationConfig(rate=60.0))


@pytest.fixture(scope='module')
def found(laboratory):
    return validate(laboratory, Scale((5,), (FAST, 2 * FAST), 0.6), machine=some_machine())


def row(found, quantity):
    return next(r for r in found.rows if r.quantity == quantity)


def test_errors_are_replicated_on_path_and_grid(found):
    # an eighth of the samples per second of the paper
    assert row(found, 'share left on the path').mean < 0.8
    assert row(found, 'share left on the grid').mean < 0.8
    assert row(found, 'share left on the grid, no noise').mean < 0.05


def test_every_calibration_predicts_the_reference_points(found):
    test = found.cells[0].reference
    assert set(test.results) == {'standstill', '15000', '30000'}
    assert 5e-6 < test.uncompensated < 9e-6
    assert max(test.residual.values()) < 0.35 * test.uncompensated


def test_calibration_and_reference_points_are_other_places():
    machine = paper_machine()
    calibration, reference = calibration_points(machine), reference_points(machine)
    assert (len(calibration), len(reference)) == (226, 200)
    distance = np.linalg.norm(calibration[:, None] - reference[None], axis=2)
    assert distance.min() > 1e-3


def test_standstill_and_on_the_fly_agree_within_their_uncertainties(found):
    assert row(found, 'standstill and on the fly within U, k = 2').mean > 85.0


def test_a_direct_instrument_agrees_with_the_calibration(found):
    assert row(found, 'grid, difference').mean < 1.5
    assert row(found, 'rotations, largest difference').mean < 25.0


def test_table_and_figures_are_written(found, laboratory, tmp_path):
    truth = found.cells[0].reference.truth
    files = write_validation(found, laboratory.measure_directly(truth, 5), tmp_path)
    names = [f.name for f in files]
    for number in range(1, 10):
        assert [n for n in names if n.startswith(f'figure{number}-')]
    assert all(f.stat().st_size > 500 for f in files)
    data = json.loads((tmp_path / 'validation.json').read_text())
    assert data['cells'] == [5]
    assert data['provenance']['verb'] == 'validate'
    assert len(data['rows']) == len(found.rows)


def test_figures_do_not_change_from_run_to_run(found, laboratory, tmp_path):
    from otf_core.reports.validation import draw_prediction

    first = draw_prediction(found, tmp_path).read_bytes()
    assert draw_prediction(found, tmp_path).read_bytes() == first


def test_a_rigid_motion_is_no_error_across_the_path():
    rng = np.random.default_rng(0)
    q, direction = rng.uniform(-1, 1, (50, 3)), rng.normal(size=(50, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    first = np.cross(direction, [0.3, 0.5, 0.8])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = np.stack([first, np.cross(direction, first)])
    field = 1e-5 * np.array([1.0, 2.0, 3.0]) + np.cross([1e-5, -2e-5, 3e-5], q)
    field += 1e-4 * rng.normal(size=(50, 1)) * direction  # along the path: not seen
    assert np.abs(across_path(field, q, axes)).max() < 1e-15


def test_range_and_verdict_of_a_row():
    passing = Row('2.1', 'a', '1 um', 'um', (1.0, 2.0, 3.0), (0.0, 2.5))
    assert passing.mean == 2.0
    assert passing.half_width == pytest.approx(4.303 / np.sqrt(3), rel=1e-3)  # t, 2 degrees
    failing = Row('2.1', 'b', '', '%', (3.0,), (0.0, 2.5))
    assert (passing.passed, failing.passed) == (True, False)
    text = format_rows([passing, failing])
    assert '2 (1 to 3) um  ok' in text
    assert '3 %  NOT REACHED' in text


def test_scale_of_the_command():
    assert len(scale(True, 10).seeds) == 2
    assert len(scale(False, 10).seeds) == 8
    np.testing.assert_allclose(np.array(scale(True, 10).feeds) * 60e3, [2500, 5000, 10000, 15000])

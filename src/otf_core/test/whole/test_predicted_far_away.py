# SPDX-License-Identifier: Apache-2.0
"""Predictions far from what was driven, on machines that share no formula with the solver."""

import json

import numpy as np
from nature import Cell, tour

from otf_core.calibration.calibrate import calibrate_runs
from otf_core.config import CalibrationConfig
from otf_core.model.kinematics import displacement
from otf_core.prediction.predict import predict
from otf_core.reports.calibration import result_to_dict

CONFIG = CalibrationConfig(reversal='none', piece_length=0.015)
LOW, HIGH = np.array([0.2, 0.15, -0.25]), np.array([0.3, 0.25, -0.15])
HEIGHT = -0.1
LANES = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (1, 1), (0.5, 1), (0.5, 0), (1, 0), (0, 1),
         (0, 0.5), (1, 0.5), (0.25, 0), (0.25, 1), (0.75, 1), (0.75, 0), (0, 0.25), (1, 0.25),
         (1, 0.75), (0, 0.75), (0, 0)]  # fmt: skip


def rigid(q):
    """Displacement per unit of three translations and three rotations, (3 n, 6)."""
    moved = np.tile(np.eye(3), (len(q), 1, 1))
    turned = np.stack([np.cross(unit, q) for unit in np.eye(3)], axis=2)
    return np.concatenate([moved, turned], axis=2).reshape(-1, 6)


def predicted(cell, folder, q, driven):
    """Error of the prediction at q and its u, (n, 3); the frame is fitted where it was driven."""
    result = calibrate_runs([cell.recording(50.0)], CONFIG)
    file = folder / f'{cell.seed}.json'
    file.write_text(json.dumps(result_to_dict(result)))
    found = predict(file, q)
    there = (displacement(result.tables, driven) - cell.error(driven)).ravel()
    frame = np.linalg.lstsq(rigid(driven), there, rcond=None)[0]
    left = np.linalg.norm((there - rigid(driven) @ frame).reshape(-1, 3), axis=1).mean()
    assert left < 2e-6
    return found.error - cell.error(q) - (rigid(q) @ frame).reshape(-1, 3), found.u


def places(cell, count=400):
    rng = np.random.default_rng(cell.seed)
    return rng.uniform(cell.machine.lower, cell.machine.upper, (count, 3))


def between(low, high, count=5):
    return np.stack(np.meshgrid(*np.linspace(low, high, count).T), axis=-1).reshape(-1, 3)


def test_from_a_tenth_of_a_metre_to_the_whole_machine_u_grows_as_the_error_does(tmp_path):
    within, growth = [], []
    for seed in (1, 2, 3):
        path = tour(LOW, HIGH)
        cell = Cell(seed, size=(0.6, 0.5, 0.4), pitch=0.05, path=path, passes=1)
        q = places(cell)
        off, u = predicted(cell, tmp_path, q, between(LOW, HIGH))
        beyond = np.max(np.maximum(LOW - q, q - HIGH), axis=1)
        within.append(np.mean(np.abs(off)[beyond > 0] <= 2 * u[beyond > 0]))
        near, far = (beyond > 0) & (beyond < 0.05), beyond > 0.2
        lengths = [np.median(np.linalg.norm(v, axis=1)) for v in (u[near], u[far], off[far])]
        growth.append(lengths[1] / lengths[0])
        # some 60 um of error there: no machine is described by a corner of a sixth of its length
        assert lengths[2] > 3e-5
    assert min(within) > 0.7
    assert np.mean(within) > 0.8
    assert min(growth) > 3.0


def test_a_single_plane_says_little_of_what_lies_off_it_and_u_says_so(tmp_path):
    within, ratio = [], []
    for seed in (1, 2, 3):
        path = np.array([[x * 0.3, y * 0.25, HEIGHT] for x, y in LANES])
        cell = Cell(seed, size=(0.3, 0.25, 0.2), pitch=0.05, path=path, passes=2)
        q = places(cell)
        plane = between([0.02, 0.02, HEIGHT], [0.28, 0.23, HEIGHT])
        off, u = predicted(cell, tmp_path, q, plane)
        within.append(np.mean(np.abs(off) <= 2 * u, axis=0))
        far = np.abs(q[:, 2] - HEIGHT) > 0.05
        near = np.abs(q[:, 2] - HEIGHT) < 0.005
        ratio.append(np.median(u[far], axis=0) / np.median(u[near], axis=0))
    assert np.min(within) > 0.6
    assert np.mean(within) > 0.85
    assert np.min(ratio) > 3.0

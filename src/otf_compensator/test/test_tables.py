# SPDX-License-Identifier: Apache-2.0
"""Tables of any chain: positions in, what to command out; no ROS."""

from pathlib import Path

import numpy as np
import pytest

from otf_compensator.tables import Tables
from otf_core.errors import ConfigError
from otf_core.model.chain import exact_position, nominal_position
from otf_core.prediction.calibration_document import load_tables

TRUNNION = Path(__file__).parents[3] / 'bags/trunnion/truth.json'


def test_linear_axes_put_the_target_where_it_is_wanted_at_any_angles():
    truth = load_tables(TRUNNION).tables
    machine, tables = truth.machine, Tables(str(TRUNNION))
    q = np.random.default_rng(1).uniform(machine.lower, machine.upper, (20, 5))
    points = tables.points(q[:, :3].tolist(), q[:, 3:].ravel())
    np.testing.assert_array_equal(points, q)
    found, corrected, notes = tables.ask(points)
    wanted, command = nominal_position(machine, q), np.hstack([corrected, q[:, 3:]])
    reached = np.linalg.norm(exact_position(truth, command) - wanted, axis=1)
    assert not notes and np.all(np.isfinite(found.error))
    before = np.linalg.norm(found.error, axis=1)
    assert reached.max() < 2e-8 < 1e-3 * before.max()


def test_without_angles_rotary_axes_stand_at_zero_and_others_are_refused():
    tables = Tables(str(TRUNNION))
    np.testing.assert_array_equal(tables.points([(0.1, 0.0, 0.2)], []), [[0.1, 0, 0.2, 0, 0]])
    with pytest.raises(ConfigError, match='needs 2 for each of 1 positions: A, C'):
        tables.points([(0.1, 0.0, 0.2)], [0.5])
    with pytest.raises(ConfigError, match='not finite'):
        tables.points([(0.1, np.nan, 0.2)], [])

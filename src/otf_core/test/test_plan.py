# SPDX-License-Identifier: Apache-2.0
"""A plan checks itself, whoever made it; what cannot be driven is refused."""

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.config import SimulationConfig
from otf_core.errors import ConfigError, InputError, ShapeError
from otf_core.model.plan import Plan
from otf_core.sim.cell import simulate

POINTS = [[0, 0, 0], [0.1, 0, 0], [0.1, 0.2, 0]]


def plan(points=POINTS, feed=(0.1, 0.2), dwell=(1.0, 0.0, 2.0)):
    return Plan.along(points, feed, dwell)


@pytest.mark.parametrize(
    ('change', 'kind', 'words'),
    [
        ({'points': POINTS[:1]}, InputError, '1 points without any motion'),
        ({'points': [[0, 0]] * 3}, ShapeError, r'shape \(n, 3\)'),
        ({'points': [*POINTS[:2], [0, np.nan, 0]]}, InputError, 'point 2 is not finite'),
        ({'feed': (0.1,)}, ShapeError, r'feed:'),
        ({'feed': 0.1}, ShapeError, r'feed:'),
        ({'feed': (0.1, 0.0)}, InputError, 'feed:'),
        ({'feed': (-0.1, 0.2)}, InputError, 'feed:'),
        ({'feed': (0.1, np.nan)}, InputError, 'feed:'),
        ({'feed': (np.inf, 0.1)}, InputError, 'feed:'),
        ({'dwell': (0.0, 0.0)}, ShapeError, r'dwell:'),
        ({'dwell': (0.0, -1e-3, 0.0)}, InputError, 'dwell:'),
        ({'dwell': (0.0, 0.0, np.inf)}, InputError, 'dwell:'),
    ],
)
def test_what_cannot_be_driven_is_refused(change, kind, words):
    with pytest.raises(kind, match=words):
        plan(**change)


def test_run_that_would_fill_the_memory_is_not_simulated():
    slow = plan(feed=(1e-6, 1e-6))
    with pytest.raises(ConfigError, match=r'3e\+05 s at 500 samples/s is too long'):
        simulate(some_machine(), slow, SimulationConfig())

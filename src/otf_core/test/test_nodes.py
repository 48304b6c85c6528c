# SPDX-License-Identifier: Apache-2.0
"""Hat functions of table nodes, against interpolation written elsewhere."""

import numpy as np
import pytest

from otf_core.model.nodes import hat_matrix


@pytest.mark.parametrize('nodes', [[0.0, 0.1, 0.15, 0.4], [-0.2, 0.3], [0.05]])
def test_hat_functions_interpolate_and_are_constant_outside(nodes):
    nodes = np.array(nodes)
    q = np.concatenate([nodes, np.linspace(-0.5, 0.6, 40)])
    value = np.random.default_rng(3).normal(size=len(nodes))
    wanted = np.interp(q, nodes, value)
    np.testing.assert_allclose(hat_matrix(nodes, q) @ value, wanted, atol=1e-14)

# SPDX-License-Identifier: Apache-2.0
"""The gauge applied to matrices, with and without values that follow others."""

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.model.nodes import table_nodes
from otf_core.solving.unknowns import layout, linear_bases, reversal_names, smooth_bases

ACROSS_ZERO = ((-0.13, 0.22), (-0.08, 0.11), (-0.31, 0.02))
BESIDE_ZERO = ((0.0, 0.35), (0.02, 0.2), (-0.31, -0.02))


@pytest.mark.parametrize('bases', [linear_bases, smooth_bases])
@pytest.mark.parametrize(('ranges', 'following'), [(ACROSS_ZERO, 12), (BESIDE_ZERO, 0)])
def test_matrices_are_lowered_and_lifted_by_the_gauge(bases, ranges, following):
    machine = some_machine(ranges=ranges)
    nodes = table_nodes(machine, machine.lower, machine.upper)
    unknowns = layout(bases(machine, nodes), 2, reversal_names(machine.motions, 1))
    G, rng = unknowns.gauge.toarray(), np.random.default_rng(6)
    follows = unknowns.full - len(unknowns.kept) - int(np.sum(~G.any(axis=1)))
    assert follows == following
    for matrix, found, wanted in (
        (M := rng.standard_normal((unknowns.full, unknowns.full)), unknowns.lowered, G.T),
        (M[: unknowns.free, : unknowns.free], unknowns.lifted, G),
    ):
        even = matrix + matrix.T
        np.testing.assert_allclose(found(even), wanted @ even @ wanted.T, rtol=0, atol=1e-10)

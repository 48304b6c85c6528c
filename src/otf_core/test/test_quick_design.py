# SPDX-License-Identifier: Apache-2.0
"""Products of the columns of the quick model are those of the matrix that they stand for."""

import numpy as np
import pytest
from scipy import sparse

from otf_core.contradictions.quick_model import AxisTables, Design

PIECES, NODES = 50, (7, 4, 1)


@pytest.fixture(params=[2, 3])
def design(request):
    rng, rows = np.random.default_rng(request.param), request.param * PIECES
    axes = []
    for nodes in NODES:
        place = rng.uniform(0, nodes - 1, PIECES)
        first = place.astype(np.int64)
        hat = np.stack([1 + first - place, place - first][: min(nodes, 2)])
        axes.append(AxisTables(nodes, first, hat, rng.normal(size=(request.param, 6, PIECES))))
    return Design(rng.normal(size=(rows, 5)), tuple(axes))


def matrix(design):
    parts = [design.usual]
    for axis in design.axes:
        hats = np.zeros((PIECES, axis.nodes))
        for k, value in enumerate(axis.hat):
            hats[np.arange(PIECES), axis.first + k] = value
        parts.append(np.einsum('cmp,pn->cpmn', axis.influence, hats).reshape(-1, 6 * axis.nodes))
    return np.hstack(parts)


def test_normal_matrix_is_that_of_all_columns(design):
    rows = matrix(design)
    weight = np.random.default_rng(5).uniform(0, 2, len(rows))
    expected = np.tril(rows.T @ (rows * weight[:, None]))
    np.testing.assert_allclose(np.tril(design.normal(weight)), expected, atol=1e-12)


def test_products_and_sums_are_those_of_all_columns(design):
    rows, rng = matrix(design), np.random.default_rng(6)
    value, columns = rng.normal(size=rows.shape[1]), rng.normal(size=(len(rows), 3))
    of_rows = sparse.csr_array(
        rng.normal(size=(8, len(rows))) * (rng.random((8, len(rows))) < 0.1)
    )
    np.testing.assert_allclose(design.times(value), rows @ value, atol=1e-12)
    np.testing.assert_allclose(design.products(columns), rows.T @ columns, atol=1e-12)
    np.testing.assert_allclose(design.sums(of_rows), of_rows @ rows, atol=1e-12)

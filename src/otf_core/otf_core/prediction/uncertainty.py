# SPDX-License-Identifier: Apache-2.0
"""Standard uncertainties of predictions, and how far residuals exceed the assumed noise."""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.model.chain import Sight
from otf_core.model.machine import Machine
from otf_core.model.nodes import hat_matrix


def prediction_rows(machine: Machine, nodes: dict[str, Array], q: Array) -> Array:
    """Derivatives of the volumetric error with respect to squareness and node values.

    Parameters
    ----------
    nodes : mapping of motion name to ndarray, m
    q : ndarray, shape (n, k), m and rad

    Returns
    -------
    ndarray, shape (n, 3, scalars + sum of nodes)
        Squareness and location errors, then the nodes of EXX, EYX, ... ECZ ...
    """
    view = Sight.of_tool(machine).at(q)
    columns = [view.scalars[name][:, :, None] for name in machine.scalars]
    hats: dict[str, tuple[Array, Array]] = {}
    for name in machine.motions:
        known, hat = hats.get(name.axis, (np.zeros(0), q))
        if not np.array_equal(known, nodes[name]):  # motions of one axis share their nodes
            own = machine.axes[name.axis].wrapped(q[:, machine.column(name.axis)])
            hat = hat_matrix(nodes[name], own)
            hats[name.axis] = nodes[name], hat
        columns.append(view.influence(name)[:, :, None] * hat[:, None, :])
    return np.concatenate(columns, axis=2)


def prediction_uncertainty(
    machine: Machine, nodes: dict[str, Array], covariance: Array, q: Array
) -> Array:
    """Standard uncertainty of predicted volumetric errors (JCGM 102, linear propagation).

    Parameters
    ----------
    nodes : mapping of motion name to ndarray, m
    covariance : ndarray, shape (m, m)
        Of squareness and nodes, in the order of ``prediction_rows``.
    q : ndarray, shape (n, k), m and rad

    Returns
    -------
    ndarray, shape (n, 3), m
        k = 1, for the errors in the gauge of the tables.
    """
    result = np.empty((len(q), 3))
    for start in range(0, len(q), 500):
        rows = prediction_rows(machine, nodes, q[start : start + 500])
        flat = rows.reshape(-1, rows.shape[2])
        variance = np.einsum('ij,ij->i', flat @ covariance, flat)
        result[start : start + 500] = np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 3)
    return result

# SPDX-License-Identifier: Apache-2.0
"""Standard uncertainties of predictions, and how far residuals exceed the assumed noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.kinematics import motion_influence, squareness_influence
from otf_core.machine import AXES, Machine
from otf_core.tables import MOTIONS, SQUARENESS
from otf_core.unknowns import interval

Array = NDArray[np.float64]

MAX_LAG = 200
"""pieces; longest distance at which residuals are searched for correlation."""


@dataclass(frozen=True)
class ResidualCheck:
    """How the residuals compare with the noise that the weights assume.

    Attributes
    ----------
    variance_ratio : float
        Sum of squared normalised residuals per degree of freedom (s0^2; 1 as specified).
    correlation_factor : float
        1 + 2 * sum of the autocorrelation of successive pieces; 1 for independent residuals.
    """

    variance_ratio: float
    correlation_factor: float

    @property
    def inflation(self) -> float:
        """Factor on the covariance of the estimates; never below 1."""
        return max(1.0, self.variance_ratio * self.correlation_factor)


def check_residuals(whitened: Array, leg: NDArray[np.int64], rank: int) -> ResidualCheck:
    """Compare residuals with the assumed noise.

    Parameters
    ----------
    whitened : ndarray, shape (c, p)
        Residuals freed of the assumed noise covariance, pieces in driving order: independent
        and of unit variance if nothing but that noise is in them. What the model lacks shows as
        size and as correlation between neighbouring pieces of a leg.
    leg : ndarray of int64, shape (p,)
    rank : int
        Number of estimated quantities.
    """
    square = float(np.mean(whitened**2))
    freedom = max(1.0, whitened.size - rank)
    total = 0.0
    for lag in range(1, min(MAX_LAG, len(leg) - 1)):
        same = leg[lag:] == leg[:-lag]
        if same.sum() < 20:
            break
        products = whitened[:, lag:][:, same] * whitened[:, :-lag][:, same]
        correlation = float(products.mean()) / max(square, 1e-300)
        if correlation < 0.05:
            break
        total += correlation
    return ResidualCheck(square * whitened.size / freedom, 1.0 + 2.0 * total)


def prediction_rows(machine: Machine, nodes: dict[str, Array], q: Array) -> Array:
    """Derivatives of the volumetric error with respect to squareness and node values.

    Parameters
    ----------
    machine : Machine
    nodes : mapping of motion name to ndarray, m
    q : ndarray, shape (n, 3), m

    Returns
    -------
    ndarray, shape (n, 3, 3 + sum of nodes)
        C0Y, B0Z, A0Z, then the nodes of EXX, EYX, ... ECZ.
    """
    columns = [squareness_influence(name, q)[:, :, None] for name in SQUARENESS]
    for name in MOTIONS:
        count = len(nodes[name])
        hat = np.zeros((len(q), count))
        index, fraction = interval(nodes[name], q[:, AXES.index(name[2])])
        row = np.arange(len(q))
        hat[row, index] = 1.0 - fraction
        if count > 1:
            hat[row, index + 1] += fraction
        columns.append(motion_influence(machine, name, q)[:, :, None] * hat[:, None, :])
    return np.concatenate(columns, axis=2)


def prediction_uncertainty(
    machine: Machine, nodes: dict[str, Array], covariance: Array, q: Array
) -> Array:
    """Standard uncertainty of predicted volumetric errors (JCGM 102, linear propagation).

    Parameters
    ----------
    machine : Machine
    nodes : mapping of motion name to ndarray, m
    covariance : ndarray, shape (m, m)
        Of squareness and nodes, in the order of ``prediction_rows``.
    q : ndarray, shape (n, 3), m

    Returns
    -------
    ndarray, shape (n, 3), m
        k = 1, for the errors in the gauge of the tables.
    """
    result = np.empty_like(q)
    for start in range(0, len(q), 500):
        rows = prediction_rows(machine, nodes, q[start : start + 500])
        flat = rows.reshape(-1, rows.shape[2])
        variance = np.einsum('ij,ij->i', flat @ covariance, flat)
        result[start : start + 500] = np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 3)
    return result

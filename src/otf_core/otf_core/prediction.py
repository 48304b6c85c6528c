# SPDX-License-Identifier: Apache-2.0
"""Volumetric errors predicted from error tables, with their standard uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.kinematics import displacement
from otf_core.results import unpack_covariance
from otf_core.tables import MOTIONS, SQUARENESS, ErrorTables, load_tables
from otf_core.uncertainty import prediction_uncertainty

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Predicted errors.

    Attributes
    ----------
    error, u : ndarray, shape (n, 3), m
        Actual minus nominal, and its standard uncertainty (k = 1).
    correlated : bool
        True if u takes account of the covariance between nodes; False if only the nodes' own
        uncertainties were known and they were taken as independent.
    """

    error: Array
    u: Array
    correlated: bool


def _independent(tables: ErrorTables) -> Array:
    own = [np.array([tables.squareness[k].u]) for k in SQUARENESS]
    own += [tables.motions[k].u for k in MOTIONS]
    return np.diag(np.concatenate(own) ** 2)


def predict(tables_path: str | Path, q: Array) -> Prediction:
    """Evaluate an error_tables.json.

    Parameters
    ----------
    tables_path : str or Path
        Any gauge; the covariance it holds, if any, is used.
    q : ndarray, shape (n, 3), m
        Programmed axis positions.

    Raises
    ------
    ConfigError
        If the tables cannot be read.
    """
    content = load_tables(tables_path)
    tables = content.tables
    nodes = {name: tables.motions[name].position for name in MOTIONS}
    size = len(SQUARENESS) + sum(len(v) for v in nodes.values())
    covariance = unpack_covariance(content.extra.get('covariance'), size)
    known = covariance is not None
    if covariance is None:
        covariance = _independent(tables)
    u = prediction_uncertainty(tables.machine, nodes, covariance, q)
    return Prediction(displacement(tables, q), u, known)

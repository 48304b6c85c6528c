# SPDX-License-Identifier: Apache-2.0
"""The covariance of error tables as plain data, exact to the last bit."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.model.machine import Machine


def pack_covariance(covariance: NDArray[np.float64], machine: Machine) -> dict[str, Any]:
    """Return a covariance as plain data: lower triangle, row by row, exact to the last bit."""
    lower = covariance[np.tril_indices(len(covariance))].astype('<f8')
    return {
        'order': f'{", ".join(machine.scalars)}, then the nodes of {", ".join(machine.motions)}',
        'size': len(covariance),
        'packing': 'lower triangle by rows, little-endian float64, base64',
        'data': base64.b64encode(lower.tobytes()).decode('ascii'),
    }


def unpack_covariance(packed: Any, size: int) -> NDArray[np.float64] | None:
    """Return the covariance of an error_tables.json, shape (size, size).

    None if it holds none, or one of another size because nodes were edited.
    """
    if not isinstance(packed, Mapping) or packed.get('size') != size:
        return None
    try:
        lower = np.frombuffer(base64.b64decode(str(packed['data']), validate=True), '<f8')
        covariance = np.zeros((size, size))
        covariance[np.tril_indices(size)] = lower
    except (KeyError, ValueError):
        return None
    return covariance + np.tril(covariance, -1).T

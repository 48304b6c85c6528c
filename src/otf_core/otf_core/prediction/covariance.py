# SPDX-License-Identifier: Apache-2.0
"""The covariance of error tables as plain data, exact to the last bit."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def pack_covariance(covariance: NDArray[np.float64]) -> dict[str, Any]:
    """Return a covariance as plain data: lower triangle, row by row, exact to the last bit."""
    lower = covariance[np.tril_indices(len(covariance))].astype('<f8')
    return {
        'order': 'C0Y, B0Z, A0Z, then the nodes of EXX, EYX, EZX, EAX, EBX, ECX, EXY ... ECZ',
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

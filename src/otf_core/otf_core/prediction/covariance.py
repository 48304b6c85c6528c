# SPDX-License-Identifier: Apache-2.0
"""The covariance of error tables as plain data, exact to the last bit."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.model.machine import Machine


def pack_covariance(
    covariance: NDArray[np.float64], machine: Machine | None = None
) -> dict[str, Any]:
    """Return a covariance as plain data: lower triangle, row by row, exact to the last bit."""
    lower = covariance[np.tril_indices(len(covariance))].astype('<f8')
    return {
        'order': _order(machine),
        'size': len(covariance),
        'packing': 'lower triangle by rows, little-endian float64, base64',
        'data': base64.b64encode(lower.tobytes()).decode('ascii'),
    }


def _order(machine: Machine | None) -> str:
    """Order of its rows in words."""
    last, location = 'Z', ''
    if machine is not None and machine.rotary_names:
        last, location = machine.axis_names[-1], f'{", ".join(machine.location)}, '
    return (
        f'C0Y, B0Z, A0Z, {location}then the nodes of EXX, EYX, EZX, EAX, EBX, ECX, EXY ... '
        f'EC{last}'
    )


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

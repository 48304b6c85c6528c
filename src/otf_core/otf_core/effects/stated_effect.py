# SPDX-License-Identifier: Apache-2.0
"""Effects as a calibration states them: taken off its data, their parameters with uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from otf_core.arrays import Array

FOUND, FILE = 'found', 'file'


@dataclass(frozen=True)
class StatedEffect:
    """One effect that was taken off.

    Attributes
    ----------
    parameters, u : mapping of str to float
        Standard uncertainties (k = 1) of those that were estimated.
    how : str
        'found' by a diagnosis, or named in a 'file'.
    """

    effect: str
    parameters: Mapping[str, float]
    u: Mapping[str, float]
    units: Mapping[str, str]
    how: str


@dataclass(frozen=True)
class RemovedEffects:
    """Effects that were taken off, and what the unknowns are uncertain by for them.

    Attributes
    ----------
    of_unknowns : ndarray, shape (full, full), m and rad
        Covariance.
    """

    stated: tuple[StatedEffect, ...]
    of_unknowns: Array


def effects_to_list(stated: Sequence[StatedEffect]) -> list[dict[str, Any]]:
    """Effects as plain data, as they stand in error_tables.json."""
    return [asdict(one) for one in stated]

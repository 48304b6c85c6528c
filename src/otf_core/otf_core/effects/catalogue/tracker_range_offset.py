# SPDX-License-Identifier: Apache-2.0
"""Range offset of the tracker: its absolute distances start at the wrong place.

delta = c e_R, with the unit vector e_R along the beam.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.effects.base import Coefficients, Contribution, Effect, Shape, Size, State, Terms


class TrackerRangeOffset(Effect):
    """All ranges too long by the same amount."""

    name: ClassVar[str] = 'tracker_range_offset'
    cause: ClassVar[str] = 'home distance (bird bath) or distance meter wrong, wrong target chosen'
    equation: ClassVar[str] = 'c e_R'
    coefficients: ClassVar[str] = 'c: range error'
    typical: ClassVar[str] = '1 um to 10 um'
    source: ClassVar[str] = (
        'parameter x10 in Muralikrishnan et al., J. Res. NIST 114 (2009) 21; Leica Absolute '
        'Tracker manual (maximum permissible error R0: 5 um)'
    )
    signature: ClassVar[str] = 'points spread radially from the tracker, more so at short range'
    needs: ClassVar[str] = 'a second tracker place on another side of the volume'
    contributions: ClassVar[tuple[Contribution, ...]] = (
        Contribution('tracker range offset', ('tracker_range_offset',)),
    )
    any_axes: ClassVar[bool] = True

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Range error."""
        return (Size('', ({'c': 1.0},), 'm'),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return c."""
        column = state.beam / np.linalg.norm(state.beam, axis=1, keepdims=True)
        return Terms(('c',), ('m',), ('',), column[:, :, None])

# SPDX-License-Identifier: Apache-2.0
"""Scale of the tracker: wrong wavelength, by wrong air temperature, pressure or humidity.

delta = m r, with the beam r from the tracker to the target.

Air: the refractivity n - 1 = 2.72e-4 (20 degC, 1013.25 hPa) is proportional to the density of
air, so its relative change is 1 / 293.15 per K and 1 / 101325 per Pa: 0.93e-6 and 2.7e-9 of the
length (Ciddor, Applied Optics 35 (1996) 1566; Edlen's equation as modified by Birch and Downs,
Metrologia 31 (1994) 315, gives the same).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import Coefficients, Contribution, Effect, Shape, Size, State, Terms

PER_KELVIN = 0.93e-6
PER_PASCAL = 2.7e-9
"""Relative change of a length measured in air, per K and per Pa."""


def _air(terms: Terms, state: State, given: Sequence[float]) -> Array:
    """Standard uncertainty from those of temperature and pressure of the air."""
    level = float(np.hypot(given[0] * PER_KELVIN, given[1] * PER_PASCAL))
    return np.full(len(terms.names), level)


class TrackerScale(Effect):
    """All ranges too long in the same proportion."""

    name: ClassVar[str] = 'tracker_scale'
    cause: ClassVar[str] = (
        'refractive index of air not as assumed, distance meter out of adjustment'
    )
    equation: ClassVar[str] = 'm r'
    coefficients: ClassVar[str] = 'm: relative error of the range'
    typical: ClassVar[str] = '1e-6 to 5e-6: -0.93e-6 per K, 0.27e-6 per hPa'
    source: ClassVar[str] = 'Ciddor, Applied Optics 35 (1996) 1566 (refractive index of air)'
    signature: ClassVar[str] = 'no trace: it is identical to equal slopes of EXX, EYY and EZZ'
    needs: ClassVar[str] = 'a calibrated length: scale bar, interferometer along a line, artefact'
    contributions: ClassVar[tuple[Contribution, ...]] = (
        Contribution('tracker scale', ('tracker_scale',)),
        Contribution('air', ('air_temperature', 'air_pressure'), size=_air),
    )
    any_axes: ClassVar[bool] = True

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Relative error of the range."""
        return (Size('', ({'m': 1.0},), 'm/m'),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return m."""
        return Terms(('m',), ('m/m',), ('',), state.beam[:, :, None])

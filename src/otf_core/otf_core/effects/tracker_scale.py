# SPDX-License-Identifier: Apache-2.0
"""Scale of the tracker: wrong wavelength, by wrong air temperature, pressure or humidity.

delta = m r, with the beam r from the tracker to the target.
"""

from __future__ import annotations

from typing import ClassVar

from otf_core.effects.base import Effect, Shape, State, Terms


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
    signature: ClassVar[str] = 'none: it is the same as equal slopes of EXX, EYY and EZZ'
    needs: ClassVar[str] = 'a calibrated length: scale bar, interferometer along a line, artefact'

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return m."""
        return Terms(('m',), ('m/m',), ('',), state.beam[:, :, None])

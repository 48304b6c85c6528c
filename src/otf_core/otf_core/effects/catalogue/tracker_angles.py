# SPDX-License-Identifier: Apache-2.0
"""Angle errors of the tracker: one family that single stations cannot tell apart.

Errors of azimuth H, zenith angle V and range R, delta = R sinV dH e_H + R dV e_V + dR e_R, with
dH = x1n/R + x1z/(R tanV) + x3/(R sinV) + x5z7/tanV + 2 x6/sinV - x8x sinH + x8y cosH
+ x11a cos2H + x11b sin2H; dV = (x1n + x2) cosV/R - x1z sinV/R + x4 + x5n9n cosV - x5z9z sinV
+ x12a cos2V + x12b sin2V; dR = x2 sinV. H counts about the tracker's third axis, one face.

Makers specify the error across the beam as a + b R. In an uncertainty budget the parameters each
take an equal share of it in mean square over the pieces: the offsets of a, the angles of b R.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import Contribution, Effect, Shape, State, Terms
from otf_core.effects.beam import Beam, beam_of

OFFSETS = ('x1n', 'x1z', 'x2', 'x3')
NO_EFFECT = 1e-9
"""Displacement per unit of a parameter, relative to the largest possible, that is rounding."""


def _amplitudes(beam: Beam) -> dict[str, tuple[Array, Array, Array]]:
    """Displacement along e_H, e_V and e_R per unit of each parameter."""
    r, sin_h, cos_h, sin_v, cos_v = beam.distance, beam.sin_h, beam.cos_h, beam.sin_v, beam.cos_v
    zero, one, level = np.zeros_like(r), np.ones_like(r), r * sin_v
    return {
        'x1n': (sin_v, cos_v, zero),
        'x1z': (cos_v, -sin_v, zero),
        'x2': (zero, cos_v, sin_v),
        'x3': (one, zero, zero),
        'x4': (zero, r, zero),
        'x5n9n': (zero, r * cos_v, zero),
        'x5z9z': (zero, -r * sin_v, zero),
        'x5z7': (r * cos_v, zero, zero),
        'x6': (2.0 * r, zero, zero),
        'x8x': (-level * sin_h, zero, zero),
        'x8y': (level * cos_h, zero, zero),
        'x11a': (level * (cos_h**2 - sin_h**2), zero, zero),
        'x11b': (level * 2.0 * sin_h * cos_h, zero, zero),
        'x12a': (zero, r * (cos_v**2 - sin_v**2), zero),
        'x12b': (zero, r * 2.0 * sin_v * cos_v, zero),
    }


def _shared_equally(terms: Terms, state: State, given: Sequence[float]) -> Array:
    """Standard uncertainties that together make the declared offset a and angle b."""
    offset, angle = given
    distance = np.linalg.norm(state.beam, axis=1)
    beam = state.beam / distance[:, None]
    along = np.einsum('ij,ijk->ik', beam, terms.columns)
    beside = terms.columns - beam[:, :, None] * along[:, None, :]
    size = np.sqrt(np.mean(np.sum(beside**2, axis=1), axis=0))
    is_offset = np.array([unit == 'm' for unit in terms.units])
    wanted = np.where(is_offset, offset, angle * np.sqrt(np.mean(distance**2)))
    # what displaces nothing on this path, but for rounding, has no share
    acts = size > NO_EFFECT * np.where(is_offset, 1.0, np.sqrt(np.mean(distance**2)))
    share = np.where(is_offset, (acts & is_offset).sum(), (acts & ~is_offset).sum())
    size, share = np.where(acts, size, np.inf), np.maximum(share, 1)
    # in each of the two directions across the beam: hence the factor 2
    return np.asarray(wanted * np.sqrt(2.0 / share) / size)


class TrackerAngles(Effect):
    """Encoder eccentricity and waves, index, tilt of the axes, beam and transit offsets."""

    name: ClassVar[str] = 'tracker_angles'
    cause: ClassVar[str] = (
        'encoders off centre (x8x, x8y horizontal; x5n9n, x5z9z vertical, with beam offset and '
        'tilt), encoder waves (x11, x12), index (x4), transit tilt (x5z7), beam tilt (x6), '
        'transit and beam offsets (x1n, x1z, x2, x3)'
    )
    equation: ClassVar[str] = (
        'R sinV dH e_H + R dV e_V + dR e_R; dH = x1n/R + x1z/(R tanV) + x3/(R sinV) + x5z7/tanV '
        '+ 2 x6/sinV - x8x sinH + x8y cosH + x11a cos2H + x11b sin2H; dV = (x1n + x2) cosV/R '
        '- x1z sinV/R + x4 + x5n9n cosV - x5z9z sinV + x12a cos2V + x12b sin2V; dR = x2 sinV'
    )
    coefficients: ClassVar[str] = 'x1n to x12b: see the equation; offsets in m, angles in rad'
    typical: ClassVar[str] = '1 um to 10 um and 1 urad to 5 urad after the factory adjustment'
    source: ClassVar[str] = (
        'Wang et al., Meas. Sci. Technol. 28 (2017), as grouped in NISTModel of ScanCal; for '
        'trackers: Muralikrishnan et al., J. Res. NIST 114 (2009) 21'
    )
    signature: ClassVar[str] = (
        'points shift across the beam as a smooth function of azimuth and zenith angle'
    )
    needs: ClassVar[str] = 'a second tracker place; two-face checks separate the parts'
    contributions: ClassVar[tuple[Contribution, ...]] = (
        Contribution('tracker angles', ('tracker_offset', 'tracker_angle'), size=_shared_equally),
    )
    any_axes: ClassVar[bool] = True

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return x1n ... x12b: offsets in m, all others in rad."""
        beam = beam_of(state)
        columns = [
            h[:, None] * beam.e_h + v[:, None] * beam.e_v + r[:, None] * beam.e_r
            for h, v, r in _amplitudes(beam).values()
        ]
        names = tuple(_amplitudes(beam))
        units = tuple('m' if n in OFFSETS else 'rad' for n in names)
        return Terms(names, units, ('',) * len(names), np.stack(columns, axis=2))

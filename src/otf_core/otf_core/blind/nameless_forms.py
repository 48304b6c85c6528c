# SPDX-License-Identifier: Apache-2.0
"""Causes that no catalogue holds, in few inputs, with the inputs that an answer should name.

As in ``departed_forms``, every form is a plain function of a ``View``; it returns the displacement
of all samples (n, 3), m, and what it depends on.
"""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.depends import PLACES, SENSES, SPEED, Depends, on
from otf_core.blind.view import View

_UNIT = np.eye(3)

Nameless = tuple[Array, Depends]


def tiring_clamp(v: View) -> Nameless:
    """A slide that stands is pulled aside by its clamp, more as the run goes on."""
    a = v.axis()
    stands = (v.sense[:, a] == 0.0) * (0.5 + v.share)
    return stands[:, None] * np.roll(_UNIT[a], 1), on(SENSES[a], besides=['time'])


def sagging_bed(v: View) -> Nameless:
    """The middle of a bed sinks as time goes on, and its ends rise."""
    a, b = v.axes()
    shape = np.exp(-2.0 * v.u[:, a] ** 2)
    sunk = v.share**1.5 * (shape - shape.mean())
    return sunk[:, None] * _UNIT[b], on('time', PLACES[a])


def warm_air(v: View) -> Nameless:
    """Air above a motor bends the beam at some azimuths and ranges, after a while."""
    reach = np.linalg.norm(v.beam, axis=1)
    azimuth = np.arctan2(v.beam[:, 1], v.beam[:, 0])
    centre = np.angle(np.exp(1j * azimuth).mean())
    off = np.angle(np.exp(1j * (azimuth - centre)))
    bent = v.share * reach**2 * np.sin(6.0 * off)
    return bent[:, None] * _UNIT[2], on('time', 'azimuth', besides=['range'])


def slow_settling(v: View) -> Nameless:
    """A soft mount settles for a second or two after every start."""
    left = np.exp(-v.since_start / v.between(0.5, 1.0))
    return left[:, None] * v.unit(), on('since_stop', besides=['acceleration'])


def oil_at_one_end(v: View) -> Nameless:
    """A slide floats up with its feed, at the end where the oil comes in."""
    a = v.axis()
    lift = (v.speed / v.feed.max()) ** 2 * (1.0 + np.tanh(1.5 * v.u[:, a]))
    return lift[:, None] * np.array([0.2, 0.1, 1.0]), on(SPEED, PLACES[a])


NAMELESS_FORMS = (tiring_clamp, sagging_bed, warm_air, slow_settling, oil_at_one_end)

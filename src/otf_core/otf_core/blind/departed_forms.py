# SPDX-License-Identifier: Apache-2.0
"""Known causes in forms that neither formula nor free form of the catalogue has.

Every form is a plain function of a ``View`` that returns a displacement of all samples (n, 3), m,
of the order of a metre; a trial scales it. A drive that is worn at one place, a table that tilts
past a support, corners rounded by a path filter: written from the mechanism, without a look at the
formulas, and sharing no code with them.
"""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.view import View

_UNIT = np.eye(3)


def _both_ends(v: View, after: Array, before: Array) -> Array:
    """Towards the inside of the corners, by weights (n,) after and before them."""
    return after[:, None] * v.inside_start + before[:, None] * v.inside_end


def corner_cosine(v: View) -> Array:
    """Rounded over 30 mm to 60 mm, as a raised cosine, in proportion to the turn."""
    reach = v.between(0.03, 0.06)

    def course(s: Array) -> Array:
        return np.where(s < reach, 0.5 + 0.5 * np.cos(np.pi * s / reach), 0.0)

    return _both_ends(v, course(v.start), course(v.end))


def corner_parabola(v: View) -> Array:
    """A parabola to a corner 30 mm to 60 mm away, longer after it than before."""
    reach = v.between(0.03, 0.045)

    def course(s: Array, length: float) -> Array:
        return np.clip(1.0 - s / length, 0.0, None) ** 2

    return _both_ends(v, course(v.start, 1.4 * reach), course(v.end, reach))


def corner_fast(v: View) -> Array:
    """Rounding that is wider the faster the leg."""
    reach = 0.04 * (v.feed / v.feed.max()) ** 2

    def course(s: Array) -> Array:
        return np.asarray(np.exp(-0.5 * (s / np.maximum(0.5 * reach, 1e-4)) ** 2))

    return _both_ends(v, course(v.start), course(v.end))


def tilt_square(v: View) -> Array:
    """The table tilts with the square of a position."""
    u = v.u[:, v.axis()]
    return (u**2 + 0.5 * u)[:, None] * np.cross(_UNIT[v.axis(2)], v.beam)


def tilt_kink(v: View) -> Array:
    """The table tilts once the load has passed a support."""
    angle = np.clip(v.u[:, v.axis()] - v.between(-0.3, 0.3), 0.0, None)
    return angle[:, None] * np.cross(_UNIT[v.axis(2)], v.beam)


def _two_screws(v: View) -> Array:
    part = np.zeros(3)
    part[list(v.axes())] = v.rng.uniform(0.6, 1.0, 2) * v.rng.choice([-1.0, 1.0], 2)
    return part


def backlash_warm(v: View) -> Array:
    """Play that doubles or halves while the run lasts."""
    size = 1.0 + v.pick(-0.6, 1.0) * (1.0 - np.exp(-3.0 * v.share)) / (1.0 - np.exp(-3.0))
    return np.asarray(size[:, None] * v.side * _two_screws(v))


def backlash_wound(v: View) -> Array:
    """Play that is taken up over the first centimetres after a reversal."""
    size = 1.0 - 0.9 * np.exp(-v.since / v.between(0.02, 0.05))
    return size * v.side * _two_screws(v)


def backlash_worn(v: View) -> Array:
    """Play that is large where a screw is worn."""
    a = v.axis()
    size = 0.3 + np.exp(-0.5 * ((v.u[:, a] - v.between(-0.4, 0.4)) / 0.35) ** 2)
    return np.asarray((size * v.sense[:, a])[:, None] * _UNIT[a])


def expansion_two(v: View) -> Array:
    """An axis that warms up quickly, then with its bed; not quite uniform."""
    course = 0.6 * (1.0 - np.exp(-v.share / 0.08)) + 0.4 * v.share**1.5
    a = v.axis()
    return np.asarray((course * (0.5 * v.u[:, a] + 0.5).clip(0.0) ** 1.15)[:, None] * _UNIT[a])


def expansion_room(v: View) -> Array:
    """Axes that breathe with the room."""
    course = np.sin(2.0 * np.pi * v.share * v.between(1.2, 2.0)) + 0.5 * v.share
    return np.asarray(course[:, None] * v.q * np.array([1.0, 0.8, 1.2]))


def drift_spindle(v: View) -> Array:
    """Spindle on, off and on again: the structure grows and shrinks."""
    on = (np.floor(v.share * v.between(3.5, 5.0)) % 2 == 0).astype(float)
    state, decay = np.zeros(len(v.time)), np.exp(-np.diff(v.time) / (0.12 * v.time[-1]))
    for k, keep in enumerate(decay.tolist(), start=1):
        state[k] = on[k] + keep * (state[k - 1] - on[k])
    return np.asarray(state[:, None] * np.array([0.3, 0.2, 1.0]))


def drift_late(v: View) -> Array:
    """A structure that stays, then gives way, then stays."""
    course = 1.0 / (1.0 + np.exp(-(v.share - v.between(0.35, 0.65)) / 0.06))
    return course[:, None] * v.unit()


def pose_creep(v: View) -> Array:
    """The tracker creeps and comes half back."""
    course = np.sin(np.pi * v.share**0.7) + 0.4 * v.share
    return course[:, None] * np.cross(v.unit(), v.beam)


def droop(v: View) -> Array:
    """A beam that droops with the cube of its reach, more where the saddle is far out."""
    a, b = v.axes()
    reach, place = 0.5 * (v.u[:, a] + 1.0), 0.5 * (v.u[:, b] + 1.0)
    return np.asarray((reach**3 * np.exp(1.5 * place))[:, None] * _UNIT[2])


def yaw_far(v: View) -> Array:
    """A gantry that racks beyond the middle only."""
    a, b = v.axes()
    bent = np.clip(v.u[:, a], 0.0, None) ** 1.5 * np.sin(1.8 * v.u[:, b])
    return np.asarray(bent[:, None] * _UNIT[a])


def cyclic_growing(v: View) -> Array:
    """A screw that wobbles more towards its end, with a second harmonic."""
    a, pitch = v.axis(), v.pick(0.016, 0.02, 0.025)
    phase = 2.0 * np.pi * v.q[:, a] / pitch + 1.0
    wave = np.sin(phase) + 0.4 * np.sin(2.0 * phase + 0.5)
    return np.asarray(((0.7 + 0.3 * v.u[:, a]) * wave)[:, None] * _UNIT[a])


def servo_soft(v: View) -> Array:
    """Loops that lag less than in proportion, and settle after every start."""
    lag = v.speed**0.8 * (1.0 - 0.7 * np.exp(-v.since_start / 0.25))
    return np.asarray(lag[:, None] * v.direction * v.rng.permutation([1.0, -0.4, 0.0]))


def ringing(v: View) -> Array:
    """The column rings after every start and calms down."""
    f, tau = v.between(3.0, 12.0), v.between(0.4, 0.8)
    wave = np.exp(-v.since_start / tau) * np.sin(2.0 * np.pi * f * v.since_start)
    return wave[:, None] * v.unit()


def _late(v: View, tau: float) -> Array:
    """The warmth of the spindle as a mass beside it feels it."""
    state, step = np.zeros(len(v.time)), np.diff(v.time) / tau
    for k, share in enumerate(step.tolist(), start=1):
        state[k] = state[k - 1] + share * (v.warmth[k - 1] - state[k - 1])
    return state


def warm_head(v: View) -> Array:
    """The head leans as the spindle warms it, later than the sensor says."""
    return np.asarray(_late(v, v.between(40.0, 90.0))[:, None] * v.unit())


def warm_screw(v: View) -> Array:
    """A screw grows with the spindle beside it, a little more than in proportion."""
    a = v.axis()
    grown = _late(v, v.between(15.0, 60.0)) ** 1.1 * (0.5 * v.u[:, a] + 0.5)
    return np.asarray(grown[:, None] * _UNIT[a])


_PLAY = frozenset({'backlash'})
_PLAY_ALONG = frozenset({'backlash', 'direction_dependent_tables'})
_EXPANSION = frozenset({'thermal_axis_expansion'})
_DRIFT = frozenset({'thermal_structure_drift', 'tracker_pose_drift'})
_ROUNDING = frozenset({'corner_rounding'})
_COUPLING = frozenset({'cross_coupling'})

FOLLOWING_FORMS = {warm_head: _DRIFT, warm_screw: _EXPANSION}
"""Forms that follow the temperature of the spindle, which the cell records."""
DEPARTED_FORMS = {
    corner_cosine: _ROUNDING,
    corner_parabola: _ROUNDING,
    corner_fast: _ROUNDING,
    tilt_square: frozenset({'table_tilt'}),
    tilt_kink: frozenset({'table_tilt'}),
    backlash_warm: _PLAY,
    backlash_wound: _PLAY,
    backlash_worn: _PLAY_ALONG,
    expansion_two: _EXPANSION,
    expansion_room: _EXPANSION,
    drift_spindle: _DRIFT,
    drift_late: _DRIFT,
    pose_creep: frozenset({'tracker_pose_drift'}),
    droop: _COUPLING,
    yaw_far: _COUPLING,
    cyclic_growing: frozenset({'cyclic_error'}),
    servo_soft: frozenset({'servo_mismatch'}),
    ringing: frozenset({'vibration'}),
}
"""Forms, and the names of causes any of which is right for each."""

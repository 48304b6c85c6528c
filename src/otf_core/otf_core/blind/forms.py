# SPDX-License-Identifier: Apache-2.0
"""Causes in forms of nature, as plain functions of what a drive does at every sample.

Every form takes a ``View`` and returns a displacement of all samples (n, 3), m, of the order of a
metre; a trial scales it. A drive that is worn at one place, a table that tilts past a support,
corners rounded by a path filter: written from the mechanism, without a look at the formulas of
catalogue and free forms, and sharing no code with them. The ``View`` is worked out from places,
directions and times of the samples alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.depends import PLACES, SENSES, SPEED, EffectInputs, depends_on
from otf_core.effects import State

STILL = 1e-10
"""m; travel from sample to sample below which an axis stands."""
SENSOR = 'signal:/spindle/temperature'
"""Of cells that record a signal beside the samples."""
ALONG = 1e-9
"""Component of the direction below which an axis does not take part."""


def since_reversal(q: Array) -> tuple[Array, Array]:
    """Sign of the last motion of an axis and its travel since it last reversed.

    Parameters
    ----------
    q : ndarray, shape (n,), m

    Returns
    -------
    sign : ndarray, shape (n,)
    travel : ndarray, shape (n,), m
    """
    step = np.diff(q, prepend=q[0])
    moving = np.abs(step) > STILL
    last = np.maximum.accumulate(np.where(moving, np.arange(len(q)), -1))
    first = int(np.argmax(moving)) if moving.any() else 0
    sign = np.sign(step)[np.where(last < 0, first, last)]
    total = np.cumsum(np.abs(step))
    turned = np.concatenate([[True], np.diff(sign) != 0])
    start = np.maximum.accumulate(np.where(turned, np.arange(len(q)), 0))
    return sign, total - total[start]


@dataclass(frozen=True)
class View:
    """A run; arrays over its samples.

    Attributes
    ----------
    time : ndarray, shape (n,), s
    share : ndarray, shape (n,)
        Of the run that is over.
    q : ndarray, shape (n, 3), m
    u : ndarray, shape (n, 3)
        Positions as -1 to 1 over the range of each axis.
    direction : ndarray, shape (n, 3)
    speed, feed : ndarray, shape (n,), m/s
        At the sample, and the highest of the motion that it belongs to.
    sense : ndarray, shape (n, 3)
        Sign of the travel of each axis, 0 where it takes no part.
    side, since : ndarray, shape (n, 3)
        Sign of the last travel of each axis, and its travel since it last reversed, m.
    start, end : ndarray, shape (n,), m
        Way from the last corner and to the next.
    inside_start, inside_end : ndarray, shape (n, 3)
        Change of direction at those corners: it points to their inside.
    since_start : ndarray, shape (n,), s
        Since the target last began to move.
    beam : ndarray, shape (n, 3), m
    warmth : ndarray, shape (n,)
        Of the spindle as its sensor has it, from 0 to 1; empty without the sensor.
    rng : numpy.random.Generator
        What is drawn by a nature itself.
    """

    time: Array
    share: Array
    q: Array
    u: Array
    direction: Array
    speed: Array
    feed: Array
    sense: Array
    side: Array
    since: Array
    start: Array
    end: Array
    inside_start: Array
    inside_end: Array
    since_start: Array
    beam: Array
    warmth: Array
    rng: np.random.Generator

    def between(self, low: float, high: float) -> float:
        """Draw a number."""
        return float(self.rng.uniform(low, high))

    def pick(self, *choices: float) -> float:
        """Draw one of some numbers."""
        return choices[int(self.rng.integers(len(choices)))]

    def axis(self, count: int = 3) -> int:
        """Draw the number of an axis, one of the first ``count``."""
        return int(self.rng.integers(count))

    def axes(self) -> tuple[int, int]:
        """Draw the numbers of two different axes."""
        first, second, _ = self.rng.permutation(3).tolist()
        return first, second

    def unit(self) -> Array:
        """Draw a direction, no component of it small."""
        v = self.rng.choice([-1.0, 1.0], 3) * self.rng.uniform(0.3, 1.0, 3)
        return np.asarray(v / np.linalg.norm(v))


def _from_0_to_1(values: Array) -> Array:
    low, high = values.min(initial=np.inf), values.max(initial=-np.inf)
    return np.asarray((values - low) / (high - low)) if high > low else values


def view_of(state: State, draw: float) -> View:
    """See all samples of a run; ``draw`` is the seed of what a nature draws itself."""
    moves = state.speed > 0
    begun = moves & ~np.concatenate([[False], moves[:-1]])
    number = np.cumsum(begun)
    started = np.concatenate([state.time[:1], state.time[begun]])[number]
    highest = np.zeros(number[-1] + 1)
    np.maximum.at(highest, number, state.speed)
    sides = [since_reversal(state.q[:, k]) for k in range(3)]
    low, high = state.machine.lower, state.machine.upper
    takes_part = np.abs(state.direction) > ALONG
    return View(
        time=state.time,
        share=state.time / state.end,
        q=state.q,
        u=2.0 * (state.q - low) / (high - low) - 1.0,
        direction=state.direction,
        speed=state.speed,
        feed=highest[number],
        sense=np.where(takes_part, np.sign(state.direction), 0.0),
        side=np.stack([s for s, _ in sides], axis=1),
        since=np.stack([t for _, t in sides], axis=1),
        start=state.from_corner,
        end=state.to_corner,
        inside_start=state.direction - state.before,
        inside_end=state.after - state.direction,
        since_start=state.time - started,
        beam=state.beam,
        warmth=_from_0_to_1(state.more.get(SENSOR, np.zeros(0))),
        rng=np.random.default_rng(int(draw)),
    )


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


def _turned(v: View, angle: Array) -> Array:
    """By an angle (n,) about any axis."""
    return angle[:, None] * np.cross(v.unit(), v.beam)


def tilt_askew(v: View) -> Array:
    """The table tilts with a position, about no axis of the machine."""
    return _turned(v, v.u[:, v.axis()])


def tilt_square(v: View) -> Array:
    """The table tilts with the square of a position."""
    u = v.u[:, v.axis()]
    return _turned(v, u**2 + 0.5 * u)


def tilt_kink(v: View) -> Array:
    """The table tilts once the load has passed a support."""
    return _turned(v, np.clip(v.u[:, v.axis()] - v.between(-0.3, 0.3), 0.0, None))


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
TILT = 'table_tilt'
_TILT = frozenset({TILT})

FOLLOWING_FORMS = {warm_head: _DRIFT, warm_screw: _EXPANSION}
"""Forms that follow the temperature of the spindle, which the cell records."""
DEPARTED_FORMS = {
    corner_cosine: _ROUNDING,
    corner_parabola: _ROUNDING,
    corner_fast: _ROUNDING,
    tilt_askew: _TILT,
    tilt_square: _TILT,
    tilt_kink: _TILT,
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
"""Forms, each with the causes that count as right for it."""


_UNIT = np.eye(3)

Nameless = tuple[Array, EffectInputs]


def tiring_clamp(v: View) -> Nameless:
    """A slide that stands is pulled aside by its clamp, more as the run goes on."""
    a = v.axis()
    stands = (v.sense[:, a] == 0.0) * (0.5 + v.share)
    return stands[:, None] * np.roll(_UNIT[a], 1), depends_on(SENSES[a], besides=['time'])


def sagging_bed(v: View) -> Nameless:
    """The middle of a bed sinks as time goes on, and its ends rise."""
    a, b = v.axes()
    shape = np.exp(-2.0 * v.u[:, a] ** 2)
    sunk = v.share**1.5 * (shape - shape.mean())
    return sunk[:, None] * _UNIT[b], depends_on('time', PLACES[a])


def warm_air(v: View) -> Nameless:
    """Air above a motor bends the beam at some azimuths and ranges, after a while."""
    reach = np.linalg.norm(v.beam, axis=1)
    azimuth = np.arctan2(v.beam[:, 1], v.beam[:, 0])
    centre = np.angle(np.exp(1j * azimuth).mean())
    off = np.angle(np.exp(1j * (azimuth - centre)))
    bent = v.share * reach**2 * np.sin(6.0 * off)
    return bent[:, None] * _UNIT[2], depends_on('time', 'azimuth', besides=['range'])


def slow_settling(v: View) -> Nameless:
    """A soft mount settles for a second or two after every start."""
    remainder = np.exp(-v.since_start / v.between(0.5, 1.0))
    return remainder[:, None] * v.unit(), depends_on('since_stop', besides=['acceleration'])


def oil_at_one_end(v: View) -> Nameless:
    """A slide floats up with its feed, at the end where the oil comes in."""
    a = v.axis()
    lift = (v.speed / v.feed.max()) ** 2 * (1.0 + np.tanh(1.5 * v.u[:, a]))
    return lift[:, None] * np.array([0.2, 0.1, 1.0]), depends_on(SPEED, PLACES[a])


NAMELESS_FORMS = (tiring_clamp, sagging_bed, warm_air, slow_settling, oil_at_one_end)

# SPDX-License-Identifier: Apache-2.0
"""What a drive does at every sample of a run, as the natures of a trial see it.

Worked out here from places, directions and times of the samples alone, apart from the history and
the inputs that catalogue and free forms use.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
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

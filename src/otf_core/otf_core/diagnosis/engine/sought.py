# SPDX-License-Identifier: Apache-2.0
"""Inputs that are sought in a residual: a period, a moment, a place, a direction of the beam.

Trial functions of each are compared by the score test (``score``); the best becomes an input if it
is clear. What depends on it is fitted exactly afterwards, and priced as all structures are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.engine.rows import Rows
from otf_core.diagnosis.engine.score import TOGETHER, Scores
from otf_core.effects.found_inputs import CYCLE, DIRECTION, MOMENT, PLACE, found_name
from otf_core.effects.inputs import functions_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SLOWEST, FASTEST = 1.5, 1.0
"""Cycles in a run, and Hz, between which a cycle in time is looked for; see ``spectral``."""
FINENESS = 4
"""Trial frequencies for every cycle in a run."""
HARMONICS = 6
"""Cosines and sines by which the period is refined."""
CLEAR = 16.0
"""Gain, less the logarithm of the number of trials, from which something is an input."""
NEAR = 100
"""Pieces before and after the best change of legs among which a moment is refined."""
PLACES = 300
"""Places and directions that are tried: those of so many pieces, spread over the path."""
WIDTHS = (0.06, 0.12, 0.25)
"""Widths of bells about them, as shares of the mean range."""
REFINED = 120
"""Gains by which centre and width are refined."""


def sought_inputs(rows: Rows, scores: Scores) -> list[str]:
    """Names of the inputs with numbers that are clear in a residual."""
    ways = (strongest_cycle, strongest_moment, strongest_place, strongest_direction)
    return [name for way in ways if (name := way(rows, scores))]


def strongest_cycle(rows: Rows, scores: Scores) -> str:
    """Phase of the strongest cycle in time; empty if there is no clear one."""
    time = np.concatenate([s.time for s in rows.states])
    length = max(s.end for s in rows.states)
    step = 1.0 / (FINENESS * length)
    frequency = np.arange(SLOWEST / length, FASTEST, step)
    if not len(frequency):
        return ''
    gains = scores.gains_of_waves(time, frequency)
    if not _is_clear(gains):
        return ''
    best = float(frequency[int(np.argmax(gains))])
    near = 1.0 / (best + step * np.linspace(-1.0, 1.0, 8 * FINENESS + 1))
    harmonics = [scores.gain(_harmonics(time, float(period))) for period in near]
    return found_name(CYCLE, float(near[int(np.argmax(harmonics))]))


def _harmonics(time: Array, period: float) -> Array:
    name = found_name(CYCLE, period)
    return functions_of(name, 2.0 * np.mod(time, period) / period - 1.0, HARMONICS)[:, 1:]


def strongest_moment(rows: Rows, scores: Scores) -> str:
    """Moment of the strongest step in time of one run; empty if there is no clear one."""
    time = np.concatenate([s.time for s in rows.states])
    run = np.repeat(np.arange(len(rows.states)), [len(s) for s in rows.states])
    leg = np.concatenate([r.pieces.leg for r in rows.runs])
    change = np.flatnonzero(np.diff(leg) * (np.diff(run) == 0)) + 1

    def gains(pieces: Index) -> Array:
        """Of steps before some pieces."""
        later = (time[:, None] >= time[pieces]) & (run[:, None] == run[pieces])
        return scores.gains_of_each(later.astype(float))

    if not len(change):
        return ''
    found = gains(change)
    if not _is_clear(found):
        return ''
    best = change[int(np.argmax(found))]
    near = np.flatnonzero((np.abs(leg - leg[best]) <= 1) & (run == run[best]))
    near = near[time[near] > time[run == run[best]].min()]
    near = near[np.abs(near - best) < NEAR]
    piece = int(near[np.argmax(gains(near))])
    return found_name(MOMENT, 0.5 * (time[piece] + time[piece - 1]))


def strongest_place(rows: Rows, scores: Scores) -> str:
    """Place in the volume about which something happens; empty if there is no clear one."""
    place = _strongest_bell(scores, np.concatenate([s.q for s in rows.states]))
    return '' if place is None else found_name(PLACE, *place)


def strongest_direction(rows: Rows, scores: Scores) -> str:
    """Direction of the beam about which something happens; empty if there is no clear one."""
    beam = np.concatenate([s.beam for s in rows.states])
    place = _strongest_bell(scores, beam / np.linalg.norm(beam, axis=1)[:, None])
    if place is None:
        return ''
    x, y, z = place
    return found_name(DIRECTION, np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)))


def _strongest_bell(scores: Scores, points: Array) -> Array | None:
    """Centre of the bell exp(-d^2 / 2 w^2) over points (p, 3) that gains most, if it is clear."""
    from scipy.spatial.distance import cdist  # 0.1 s

    extent = float(np.mean(np.ptp(points, axis=0)))
    stride = max(1, len(points) // PLACES)
    trials = [(p, w * extent) for p in points[stride // 2 :: stride] for w in WIDTHS]

    def bells(some: list[tuple[Array, float]]) -> Array:
        places, widths = (np.array(part) for part in zip(*some, strict=True))
        return np.asarray(np.exp(-0.5 * cdist(points, places, 'sqeuclidean') / widths**2))

    parts = (trials[k : k + TOGETHER] for k in range(0, len(trials), TOGETHER))
    gains = np.concatenate([scores.gains_of_each(bells(part)) for part in parts])
    if not _is_clear(gains):
        return None
    place, width = trials[int(np.argmax(gains))]

    def loss(moved: Array) -> float:
        own = place + width * moved[:3], width * float(np.exp(moved[3]))
        return -float(scores.gains_of_each(bells([own]))[0])

    from scipy.optimize import minimize  # 0.1 s

    best = minimize(loss, np.zeros(4), method='Nelder-Mead', options={'maxfev': REFINED})
    return np.asarray(place + width * best.x[:3])


def _is_clear(gains: Array) -> bool:
    return bool(gains.max() - np.log(len(gains)) >= CLEAR)

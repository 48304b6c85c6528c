# SPDX-License-Identifier: Apache-2.0
"""Inputs that are sought in a residual: a period, a moment, a place, a direction of the beam.

Trial functions of each are compared by the score test (``score``); the best becomes an input if it
is clear. Cycles along axes are lines in the spectra of single samples. What depends on an input is
fitted exactly afterwards, and priced as all structures are.
"""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.score import TOGETHER, Scores
from otf_core.diagnosis.engine.spectral import LINE_SCORE, line_across_axis, line_along_axis
from otf_core.effects.inputs import functions_of
from otf_core.effects.located_inputs import CYCLE, DIRECTION, MOMENT, PLACE, TURNS, found_name

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
CENTRES = 4
"""Bells that are fitted exactly, none of them within another."""
REFINED = 120
"""Gains by which centre and width are refined."""


def find_inputs(rows: Rows, scores: Scores) -> list[str]:
    """Names of the inputs with numbers that are clear in a residual."""
    names = [strongest_cycle(rows, scores), strongest_moment(rows, scores)]
    names += strongest_places(rows, scores) + strongest_directions(rows, scores)
    return [name for name in names if name] + cycles_along_axes(rows)


def cycles_along_axes(rows: Rows) -> list[str]:
    """Phases of what repeats along an axis, of each axis at most one."""
    found: dict[str, tuple[float, float]] = {}
    for residuals in rows.sample_residuals():
        for head, k in TURNS.items():
            axis = residuals.state.machine.axis_names[k]
            for peak in (line_along_axis(residuals, axis), line_across_axis(residuals, axis)):
                if peak is not None and peak[1] > found.get(head, (0.0, LINE_SCORE))[1]:
                    found[head] = peak
    return [found_name(head, period) for head, (period, _) in found.items()]


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


def strongest_places(rows: Rows, scores: Scores) -> list[str]:
    """Places in the volume about which something happens; none if no one is clear."""
    places = _strongest_bells(scores, np.concatenate([s.q for s in rows.states]))
    return [found_name(PLACE, *place) for place in places]


def strongest_directions(rows: Rows, scores: Scores) -> list[str]:
    """Directions of the beam about which something happens; none if no one is clear."""
    beam = np.concatenate([s.beam for s in rows.states])
    places = _strongest_bells(scores, beam / np.linalg.norm(beam, axis=1)[:, None])
    return [
        found_name(DIRECTION, np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)))
        for x, y, z in places
    ]


def _strongest_bells(scores: Scores, points: Array) -> list[Array]:
    """Centres of bells exp(-d^2 / 2 w^2) over points (p, 3) that gain most, where one is clear.

    Tables follow a part of a bell, the more the less of it the path meets: the gain of the right
    one need not be the largest.
    """
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
        return []
    from scipy.optimize import minimize  # 0.1 s

    def refined(place: Array, width: float) -> Array:
        def loss(moved: Array) -> float:
            own = place + width * moved[:3], width * float(np.exp(moved[3]))
            return -float(scores.gains_of_each(bells([own]))[0])

        best = minimize(loss, np.zeros(4), method='Nelder-Mead', options={'maxfev': REFINED})
        return np.asarray(place + width * best.x[:3])

    kept: list[tuple[Array, float]] = []
    for place, width in (trials[k] for k in np.argsort(gains)[::-1]):
        if all(np.linalg.norm(place - p) > max(width, w) for p, w in kept):
            kept.append((place, width))
        if len(kept) == CENTRES:
            break
    return [refined(*one) for one in kept]


def _is_clear(gains: Array) -> bool:
    return bool(gains.max() - np.log(len(gains)) >= CLEAR)

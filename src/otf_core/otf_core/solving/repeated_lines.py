# SPDX-License-Identifier: Apache-2.0
"""Lines that laps repeat, taken once with the weight of all passes.

Rows of a line are the same in every lap, but for where in a piece its samples happen to lie (half
a step between samples at most). Were they the same, nothing would be lost of l passes with
deviations y_l and inverse covariances W_l in

    W = sum_l W_l,    y = W^-1 sum_l W_l y_l,
    sum_l (y_l - v)^T W_l (y_l - v) = (y - v)^T W (y - v) + sum_l y_l^T W_l y_l - y^T W y

and sums over rows would grow with the path, not with the time that it is driven. What is compared,
or repeated until nothing changes, may do with that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Index
from otf_core.solving.system import System
from otf_core.solving.whitener import Whitener


@dataclass(frozen=True)
class Once:
    """Rows of lines with the weight of all passes.

    Attributes
    ----------
    system : System
        Of the first pass over every line, with deviations y.
    whitener : Whitener
        For W.
    pieces : ndarray of int64
        Their places among all pieces.
    square : float
        What the passes differ, weighted sum of squares.
    rows : int
        Of all passes.
    """

    system: System
    whitener: Whitener
    pieces: Index
    square: float
    rows: int


def weigh_repeated_lines(system: System, whitener: Whitener) -> Once:
    """Take every line once with the weight of all passes over it."""
    rows, once = system.deviation.size, whitener.once
    if once is whitener:
        return Once(system, whitener, np.arange(len(system.q)), 0.0, rows)
    lines, line = np.unique(whitener.first, return_inverse=True)
    several = np.bincount(line) > 1
    pieces = np.concatenate([np.arange(*whitener.bounds[leg]) for leg in lines.tolist()])
    # whatever is treated together with repeated lines costs less than to set these apart
    pulled = whitener.beside(several[line]).weighted(system.deviation)
    pulled[:, ~np.repeat(several[line], [high - low for low, high in whitener.bounds])] = 0.0
    place = np.concatenate([np.arange(*once.bounds[k]) for k in line.tolist()])
    pull = np.array([np.bincount(place, own) for own in pulled], dtype=float)
    mean = system.deviation[:, pieces]
    again = np.repeat(several, [high - low for low, high in once.bounds])
    mean[:, again] = once.beside(several).covaried(pull)[:, again]
    square = float(np.sum(system.deviation * pulled) - np.sum(mean * pull))
    return Once(replace(system.at(pieces), deviation=mean), once, pieces, square, rows)

# SPDX-License-Identifier: Apache-2.0
"""How far inside its curves a machine drives: filters and lags of the drives.

A moving average of length T, or a second-order lag, puts a machine driving at speed v on a curve
of curvature k inside it by c v^2 k (c = T^2 / 24 for the average; ISO 230-4 calls the outcome the
radial deviation). Lines do not show it, tables can take it for errors of scale. So where a run has
curves, c is estimated beside the tables as one more unknown of the run: with residuals r, weights
W, the column b of c across the path and the change S of the tables per unit of it,

    c = b^T W r / b^T W (b - A S).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from otf_core.pieces.runs import AnyRun, Observed
from otf_core.solving.joint import JointSolution
from otf_core.solving.model_choice import ReversalSolution
from otf_core.solving.sensitivity import ROUNDING, beside_tables, components_across

MIN_SIGNIFICANCE = 6.0
"""Standard deviations; curves share slow noise, so that these are somewhat too small."""
MIN_LAG = 1e-7
"""m; driven inside by less is left as it is."""
MAX_UNMENTIONED_U = 1e-6
"""m; an uncertainty of it that is worth a remark."""


def lags(runs: Sequence[Observed], joint: JointSolution) -> list[tuple[float, float]]:
    """Square of time by which each run drives inside its curves, and its uncertainty, s^2.

    Both are zero for a run without curves. The uncertainty holds what the residuals have beyond
    the assumed noise, and how the curves of the run differ: parts of one share slow noise.
    """
    if not any(len(run.pieces.bend) for run in runs):
        return [(0.0, 0.0)] * len(runs)
    columns = [
        components_across(solved, run.pieces.bend[:, :, None])
        if len(run.pieces.bend)
        else np.zeros((*solved.system.deviation.shape, 1))
        for run, solved in zip(runs, joint.runs, strict=True)
    ]
    places = [np.array([k]) for k in range(len(runs))]
    products, estimates = beside_tables(joint, columns, places, len(runs)), []
    for k, (run, solved) in enumerate(zip(runs, joint.runs, strict=True)):
        own = float(products.normal[k, k])
        if own <= ROUNDING * products.square[k]:
            estimates.append((0.0, 0.0))
            continue
        column = columns[k][..., 0] - solved.system.rows.times(products.change[:, k])
        weights = solved.whitener.weighted(columns[k][..., 0])
        white = solved.whitener.whiten(solved.residual)
        scale = max(1.0, float(np.sqrt(np.mean(white**2))))
        lag = float(products.right[k]) / own
        parts = np.sum(weights * (solved.residual - lag * column), axis=0)
        curve = run.shape.stretch[run.pieces.line]
        spread = float(np.sqrt(np.sum(np.bincount(curve, parts) ** 2))) / own
        estimates.append((lag, max(scale / np.sqrt(own), spread)))
    return estimates


def move_onto_curves(
    runs: Sequence[AnyRun], solved: ReversalSolution[AnyRun]
) -> list[AnyRun] | None:
    """Runs whose paths lie as far inside their curves as was driven; None if none does.

    Parameters
    ----------
    runs : sequence of Observed
        With all their pieces.
    solved : ReversalSolution
        Of these runs.
    """
    moved = list(runs)
    estimates = lags(solved.runs, solved.joint)
    for k, (run, (lag, u)) in enumerate(zip(runs, estimates, strict=True)):
        if _size(run, lag) > MIN_LAG and abs(lag) > MIN_SIGNIFICANCE * u:
            shift = lag * run.pieces.bend
            pieces = replace(run.pieces, origin=run.pieces.origin + shift)
            moved[k] = replace(run, pieces=pieces)
    return None if all(a is b for a, b in zip(moved, runs, strict=True)) else moved


def _size(run: Observed, lag: float) -> float:
    """How far a run drives inside its curves at most, m."""
    bend = run.pieces.bend
    return abs(lag) * float(np.linalg.norm(bend, axis=1).max()) if len(bend) else 0.0


def curve_remarks(runs: Sequence[Observed], joint: JointSolution) -> list[str]:
    """What the reader of a result should know of the curves of its runs."""
    remarks = []
    for run, (_, u) in zip(runs, lags(runs, joint), strict=True):
        if _size(run, u) > MAX_UNMENTIONED_U:
            remarks.append(
                f'how far inside its curves the machine drives (filters, lag) is uncertain by '
                f'{1e6 * _size(run, u):.2g} um, which the stated uncertainties do not hold: add '
                f'straight lines to the path'
            )
    return remarks

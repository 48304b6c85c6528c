# SPDX-License-Identifier: Apache-2.0
"""Which of the effects found matter, and what is left of the gap with each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.engine.decoys import DECOY_NAMES
from otf_core.diagnosis.engine.gap_sizes import Residuals, gap_um, plain_residuals, residuals_with
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.rival import Rival
from otf_core.diagnosis.engine.search import Cause, fit_out, noise_variance
from otf_core.diagnosis.verdict import matters
from otf_core.effects import Effect

MATERIAL_SHARE = 0.12
"""Least share of a further cause in the gap, as amplitude."""
FREE_OF_STRUCTURE = 1.2
"""Correlation of neighbouring pieces below which residuals count as noise."""
NOISE_RANGE = (0.7, 1.4)
"""Variances by which the twin's noise may be corrected."""


@dataclass(frozen=True)
class Explanation:
    """Causes that matter and the residuals with them.

    Attributes
    ----------
    causes : tuple of Cause
        Effects of the catalogue, in the order found.
    twin_um, simulated_um : float
        Residual of the simulation, and with its noise corrected by what the causes leave.
    steps : tuple of Residuals
        Without causes, with the first, with the first two ... (held out).
    fitted : Residuals
        With all causes fitted to all legs.
    known_um : float
        Residual with the effects of the catalogue that the data speak for, too small ones to be
        named included (held out), um.
    known_rest : Residuals
        The same, fitted to all legs.
    structured : bool
        True if neighbouring pieces share more of the residual than noise explains.
    decoyed : bool
        True if shapes outside the catalogue explain more than the causes.
    """

    causes: tuple[Cause, ...]
    twin_um: float
    simulated_um: float
    steps: tuple[Residuals, ...]
    fitted: Residuals
    known_um: float
    known_rest: Residuals
    structured: bool
    decoyed: bool

    @property
    def before_um(self) -> float:
        """Gap without causes, um."""
        return gap_um(self.steps[0].rms_um, self.simulated_um)

    @property
    def after_um(self) -> float:
        """Gap with all causes, on legs they were not fitted on, um."""
        return gap_um(self.steps[-1].rms_um, self.simulated_um)

    def doubted(self, rival: Rival) -> Explanation:
        """The same with confidences that count something else and nothing."""
        causes = tuple(replace(c, confidence=rival.confidence(c)) for c in self.causes)
        return replace(self, causes=causes)

    def without_causes(self, simulated_um: float) -> Explanation:
        """The same with nothing named: where no effect explains the gap."""
        first = self.steps[0]
        return replace(self, causes=(), simulated_um=simulated_um, steps=(first,), fitted=first)


def explain(rows: Rows, found: Sequence[Cause], twin_um: float) -> Explanation:
    """Keep the effects that matter.

    Parameters
    ----------
    found : sequence of Cause
        What the search found, decoys among them, in its order.
    twin_um : float
        Residual of the simulation.
    """
    simulated_um = twin_um * noise_level(rows, found)
    causes, steps = _named(rows, found, simulated_um)
    decoyed = _decoyed(causes, steps)
    kept = [c for c in causes if _in_catalogue(c)]
    if len(kept) < len(causes):  # what a decoy takes away is not explained
        causes = kept
        steps = [residuals_with(rows, kept[:k]) for k in range(len(kept) + 1)]
    fitted = residuals_with(rows, causes, held_out=False)
    # what is found after a decoy lives on what that left
    first = takewhile(_in_catalogue, found)
    known = [*causes, *(c for c in first if all(c is not named for named in causes))]
    known_um, rest = steps[-1].rms_um, fitted
    if len(known) > len(causes):
        known_um = min(known_um, residuals_with(rows, known).rms_um)
        rest = residuals_with(rows, known, held_out=False)
    structured = _structure(rows, rows.residual) > FREE_OF_STRUCTURE
    levels = twin_um, simulated_um
    return Explanation(
        tuple(causes), *levels, tuple(steps), fitted, known_um, rest, structured, decoyed
    )


def _named(
    rows: Rows, found: Sequence[Cause], simulated_um: float
) -> tuple[list[Cause], list[Residuals]]:
    """Causes that matter, and the residuals step by step."""
    whole = plain_residuals(rows)
    gap = gap_um(whole.rms_um, simulated_um)
    causes, steps = _material(rows, found, whole, gap, all_alike=False)
    if not causes and matters(gap, simulated_um):
        return _material(rows, found, whole, gap, all_alike=True)
    return causes, steps


def _material(
    rows: Rows, found: Sequence[Cause], whole: Residuals, gap: float, *, all_alike: bool
) -> tuple[list[Cause], list[Residuals]]:
    """Causes whose own trace matters, in itself and beside the whole gap.

    ``all_alike`` asks no more of those that smooth machines have a little of than of others.
    """
    causes: list[Cause] = []
    steps = [whole]
    for cause in found:
        after = residuals_with(rows, [*causes, cause])
        trace = float(np.sqrt(max(0.0, steps[-1].rms_um ** 2 - after.rms_um**2)))
        least = Effect.material_um if all_alike else cause.option.effect.material_um
        if trace > max(least, MATERIAL_SHARE * gap):
            causes.append(cause)
            steps.append(after)
    return causes, steps


def noise_level(rows: Rows, found: Sequence[Cause]) -> float:
    """Correction of the twin's noise, from what the causes leave.

    How fast noise averages out over a piece is known to some ten percent from short stops. If
    what is left has no structure, its size tells better.
    """
    residual = rows.residual
    for cause in found:
        residual = fit_out(cause.option, residual)
    structure = _structure(rows, residual)
    variance = float(np.mean(residual**2)) * len(residual) / (len(residual) - rows.base.shape[1])
    if structure > FREE_OF_STRUCTURE or not NOISE_RANGE[0] < variance < NOISE_RANGE[1]:
        return 1.0
    return float(np.sqrt(variance))


def _structure(rows: Rows, residual: Array) -> float:
    """Inflation by the correlation of neighbouring pieces; 1 for noise as assumed."""
    return noise_variance(rows, residual) / max(float(np.mean(residual**2)), 1.0)


def _in_catalogue(cause: Cause) -> bool:
    return cause.option.effect.name not in DECOY_NAMES


def _decoyed(causes: Sequence[Cause], steps: Sequence[Residuals]) -> bool:
    """Tell whether shapes outside the catalogue explain more than the effects named."""
    power = {True: 0.0, False: 0.0}
    for cause, before, after in zip(causes, steps[:-1], steps[1:], strict=True):
        power[not _in_catalogue(cause)] += max(0.0, before.rms_um**2 - after.rms_um**2)
    return power[True] > power[False]

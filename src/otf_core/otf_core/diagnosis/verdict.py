# SPDX-License-Identifier: Apache-2.0
"""The verdict on a gap (docs/conventions.md, gap.json), from its sizes and what is left of it."""

from __future__ import annotations

from dataclasses import dataclass

NO_GAP_SHARE = 0.35
"""Gap over simulated residual below which there is nothing to explain."""
PLAIN_GAP_SHARE = 0.6
"""The same for a residual without structure: the level of noise is known to ten percent only."""
EXPLAINED_SHARE, KNOWN_SHARE = 0.3, 0.55
"""Share of the gap left (as amplitude) up to which it counts as explained; as known at all."""
PLACED_EXPLAINED_SHARE, PLACED_KNOWN_SHARE = 0.1, 0.25
"""The same where what is left has a place or a shape: a cause leaves noise, a wrong one a part of
the true one."""


@dataclass(frozen=True)
class Case:
    """What a verdict depends on.

    Attributes
    ----------
    simulated_um : float
        Residual of the simulation.
    before_um, after_um : float
        Gap without and with the causes named.
    beyond_um : float
        Gap with everything of the catalogue that the data speak for, too small to be named or not.
    named : bool
        True if a cause is named.
    structured : bool
        True if neighbouring pieces share more of the residual than noise explains.
    left_has_place : bool
        True if what is left stands out somewhere.
    decoyed : bool
        True if shapes outside the catalogue explain more than the causes.
    """

    simulated_um: float
    before_um: float
    after_um: float
    beyond_um: float
    named: bool
    structured: bool
    left_has_place: bool
    decoyed: bool


def matters(gap_um: float, simulated_um: float) -> bool:
    """Tell whether a gap is large enough beside the simulated residual to be explained."""
    return gap_um > NO_GAP_SHARE * simulated_um


def verdict_of(case: Case) -> str:
    """Return 'none', 'explained', 'partly_explained' or 'unknown'."""
    if case.decoyed:
        return 'unknown'
    if not case.named:
        least = NO_GAP_SHARE if case.structured else PLAIN_GAP_SHARE
        return 'none' if case.before_um < least * case.simulated_um else 'unknown'
    explained, known = EXPLAINED_SHARE, KNOWN_SHARE
    if case.left_has_place:
        explained, known = PLACED_EXPLAINED_SHARE, PLACED_KNOWN_SHARE
    if case.beyond_um > max(known * case.before_um, NO_GAP_SHARE * case.simulated_um):
        return 'unknown'
    left = case.after_um if matters(case.after_um, case.simulated_um) else 0.0
    return 'explained' if left <= explained * case.before_um else 'partly_explained'

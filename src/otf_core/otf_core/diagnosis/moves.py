# SPDX-License-Identifier: Apache-2.0
"""Moves of tracker or target that are none: a cycle in time looks like steps.

The examination takes what changes quickly for a move and cuts the run there; a diagnosis looks at
the whole run. Where a cycle leaves hardly any of the gap, no move is left either. Other functions
of time follow a true move as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from otf_core.diagnosis.unnamed_cause import Unnamed
from otf_core.diagnosis.verdict import EXPLAINED_SHARE
from otf_core.effects.located_inputs import CYCLE, MOMENT, head_of
from otf_core.pieces.finding import WARNING, Finding

WORDS = '; the cycle that this diagnosis finds explains the run as well, without a move'


def qualify_moves(findings: Sequence[Finding], unnamed: Unnamed | None) -> tuple[Finding, ...]:
    """Say so beside findings of moves.

    Parameters
    ----------
    unnamed : Unnamed, optional
        What explains the gap, if it has no name.
    """
    if unnamed is None or unnamed.after_um > EXPLAINED_SHARE * unnamed.before_um:
        return tuple(findings)
    heads = {head_of(curve.input) for curve in unnamed.curves}
    if CYCLE not in heads or MOMENT in heads:
        return tuple(findings)
    return tuple(
        replace(f, words=f.words + WORDS) if (f.check, f.severity) == ('moved', WARNING) else f
        for f in findings
    )

# SPDX-License-Identifier: Apache-2.0
"""Causes that stand on their own evidence beside what has no name.

Where the causes found do not explain a gap to the end, an empirical effect is fitted to what they
leave. Each cause is then judged with the others and that effect in the model: by the evidence that
it adds to theirs, and by what it takes of the residual on legs that nothing was fitted on. The
cause that adds least and too little goes, and what is left is sought anew, until all that are left
stand. What only imitated the cause without a name adds nothing beside it. If no cause stands, or
if the empirical effect alone is as likely with fewer functions, the gap has no name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.engine.empirical_structure import (
    Structure,
    Structures,
    find_another,
    find_structure,
    try_structures,
)
from otf_core.diagnosis.engine.evidence import joint_evidence
from otf_core.diagnosis.engine.gap_sizes import Residuals, residuals_with, wave_um
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import (
    NEEDED_EVIDENCE,
    Cause,
    displacement_of,
    fit_jointly,
    noise_variance,
    trace_of,
)

LEAST_BESIDES = 0.15
"""Share of the squared gap that each structure but the first must take."""
MOST_STRUCTURES = 3


@dataclass(frozen=True)
class StandingCauses:
    """Causes that stand, and the structures beside them.

    Attributes
    ----------
    causes : tuple of Cause
        In the order found.
    structures : tuple of Structure
        Of what they leave; none where it has no structure.
    evidence : float
        Of all together.
    added : tuple of float
        Evidence that each cause, and then each structure, adds to all others.
    residuals : Residuals
        With all of them, on legs that they were not fitted on.
    variance : float
        Of the noise for which they are weighed.
    """

    causes: tuple[Cause, ...]
    structures: tuple[Structure, ...]
    evidence: float
    added: tuple[float, ...]
    residuals: Residuals
    variance: float

    @classmethod
    def of(
        cls,
        rows: Rows,
        causes: Sequence[Cause],
        structures: Sequence[Structure],
        variance: float = np.inf,
    ) -> StandingCauses:
        """Weigh causes and structures together, for the noise that they leave, or for less."""
        every = [*causes, *(s.cause for s in structures)]
        options = [c.option for c in every]
        variance = min(variance, _variance(rows, every))
        whole = joint_evidence(options, rows.residual, variance)
        rest = [[o for o in options if o is not c.option] for c in every]
        added = tuple(whole - joint_evidence(r, rows.residual, variance) for r in rest)
        residuals = residuals_with(rows, every)
        price = sum(s.price for s in structures)
        return cls(tuple(causes), tuple(structures), whole - price, added, residuals, variance)

    def confidence(self, number: int, other: StandingCauses | None) -> float:
        """Probability of a cause among the effects, given the others.

        Parameters
        ----------
        other : StandingCauses, optional
            Without causes: what else may explain the gap.
        """
        odds = -np.inf if other is None or other is self else other.evidence - self.evidence
        against = np.logaddexp.reduce([0.0, odds, NEEDED_EVIDENCE - self.added[number]])
        return self.causes[number].confidence * float(np.exp(-against))

    def with_names(self, exclude: Sequence[str]) -> StandingCauses:
        """Give structures that depend and act as an effect of the catalogue its name."""
        used = {*exclude, *(c.option.effect.name for c in self.causes)}
        own = self.added[len(self.causes) :]
        named: list[tuple[Cause, float]] = []
        rest: list[tuple[Structure, float]] = []
        for structure, added in zip(self.structures, own, strict=True):
            cause = structure.named(used)
            if cause is None:
                rest.append((structure, added))
            else:
                named.append((cause, added))
                used.add(cause.option.effect.name)
        return replace(
            self,
            causes=(*self.causes, *(c for c, _ in named)),
            structures=tuple(s for s, _ in rest),
            added=(*self.added[: len(self.causes)], *(a for _, a in (*named, *rest))),
        )


def standing_causes(rows: Rows, causes: Sequence[Cause], least_um: float) -> StandingCauses | None:
    """Keep the causes that stand beside each other and what has no name; None if none does.

    Parameters
    ----------
    causes : sequence of Cause
        In the order found.
    least_um : float
        Root mean square that a cause takes of the residual at least.
    """
    remaining = list(causes)
    while remaining:
        standing = stand_beside(rows, remaining)
        weak = _weakest(rows, standing, least_um)
        if weak is None:
            return standing
        remaining = [c for c in remaining if c is not weak]
    return None


def stand_beside(rows: Rows, causes: Sequence[Cause]) -> StandingCauses:
    """Causes with the structures of what they leave."""
    rest = rows.without(_displacement(rows, causes))
    return StandingCauses.of(rows, causes, structures_of(rest))


def structures_of(rows: Rows, tried: Structures | None = None) -> list[Structure]:
    """Structures of a residual, each of which takes enough of it on legs not fitted on."""
    tried = tried or try_structures(rows)
    first = find_structure(tried)
    if first is None:
        return []
    structures = [first]
    residuals = [residuals_with(rows, []), residuals_with(rows, [first.cause])]
    least = LEAST_BESIDES * (residuals[0].rms_um ** 2 - residuals[1].rms_um ** 2)
    while len(structures) < MOST_STRUCTURES:
        other = find_another(tried, structures)
        if other is None:
            break
        residuals.append(residuals_with(rows, [s.cause for s in (*structures, other)]))
        if residuals[-2].rms_um ** 2 - residuals[-1].rms_um ** 2 < least:
            break
        structures.append(other)
    return structures


def _weakest(rows: Rows, standing: StandingCauses, least_um: float) -> Cause | None:
    """The cause that adds least, if that is too little; None if all stand."""
    every = [*standing.causes, *(s.cause for s in standing.structures)]
    worst, weak = 0.0, None
    for cause, added in zip(standing.causes, standing.added, strict=False):
        rest = residuals_with(rows, [c for c in every if c is not cause])
        reduction = float(np.sqrt(max(0.0, rest.rms_um**2 - standing.residuals.rms_um**2)))
        reduction = max(reduction, wave_um(cause, rows))
        least = max(least_um, cause.option.effect.material_um)
        lacking = max(1.0 - added / NEEDED_EVIDENCE, 1.0 - reduction / least)
        if lacking > worst:
            worst, weak = lacking, cause
    return weak


def _displacement(rows: Rows, causes: Sequence[Cause]) -> Array:
    """Displacement across the path by causes fitted together, shape (r,), m."""
    return displacement_of(causes, fit_jointly(causes, rows).value)


def _variance(rows: Rows, causes: Sequence[Cause]) -> float:
    """Variance of the noise that causes leave."""
    return noise_variance(rows, rows.residual - trace_of(causes, rows))

# SPDX-License-Identifier: Apache-2.0
"""What is stated first of a calibration: the volumetric error, and how well it is known.

One grid (``evaluation.lattice`` over the whole volume, best rigid motion taken out), one coverage
factor, mean beside mean and largest beside largest. The uncertainty that comes first holds the
systematic contributions: those of machine.yaml, and typical values for what it does not declare.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.budget.budget import OBSERVED, Budget
from otf_core.budget.typical import TypicalSystematic
from otf_core.model.expanded import micro_figure, micro_significant, micro_with_expanded
from otf_core.model.presets import TYPICAL
from otf_core.prediction.volumetric import VolumetricError, length_sizes

Array = NDArray[np.float64]

DECLARED, PARTLY, ASSUMED = 'declared', 'partly typical', 'typical'


@dataclass(frozen=True)
class Headline:
    """Volumetric error and its expanded uncertainty on one grid.

    Attributes
    ----------
    points : int
        Of the grid over the whole volume.
    error : mapping of 'mean', 'p95', 'max' to float, m
        Lengths of the error vectors as the machine stands.
    expanded : mapping of the same, m
        Expanded uncertainty of the error vectors, systematic contributions included: what is to
        be expected after compensation.
    observed : mapping of the same, m
        Expanded uncertainty that the run itself shows: noise and misfit, nothing systematic.
    of_largest : float, m
        Expanded uncertainty of the length of the largest error vector.
    k : float
        Coverage factor of all of them.
    systematic : str
        'declared', 'typical' or 'partly typical': where the systematic contributions come from.
    assumed : tuple of str
        Contributions for which typical values stand, as the budget calls them.
    """

    points: int
    error: Mapping[str, float]
    expanded: Mapping[str, float]
    observed: Mapping[str, float]
    of_largest: float
    k: float
    systematic: str
    assumed: tuple[str, ...]

    @property
    def label(self) -> str:
        """Where the systematic contributions come from, in a few words."""
        return {
            DECLARED: 'systematic contributions as declared',
            PARTLY: 'systematic contributions declared, the missing ones typical, not declared',
            ASSUMED: 'systematic contributions typical, not declared',
        }[self.systematic]

    @property
    def error_words(self) -> str:
        """The volumetric error as the machine stands."""
        mean = micro_figure(self.error['mean'], self.expanded['mean'])
        largest = micro_with_expanded(self.error['max'], self.of_largest)
        return f'volumetric error as the machine stands: mean {mean}, largest {largest}'

    @property
    def expanded_words(self) -> str:
        """What is to be expected after compensation."""
        mean, largest = (micro_significant(self.expanded[s]) for s in ('mean', 'max'))
        return (
            f'expected after compensation: mean {mean}, largest {largest} '
            f'(U, k = {self.k:.3g}; {self.label})'
        )

    @property
    def observed_words(self) -> str:
        """The part that the run itself shows."""
        mean, largest = (micro_significant(self.observed[s]) for s in ('mean', 'max'))
        return f'noise and misfit of this run alone: mean {mean}, largest {largest} (U)'

    @property
    def words(self) -> tuple[str, str, str]:
        """Three lines: error, uncertainty, noise alone."""
        return self.error_words, self.expanded_words, self.observed_words

    def to_dict(self) -> dict[str, Any]:
        """Entry ``headline`` of error_tables.json, SI."""
        return {
            'unit': 'm',
            'points': self.points,
            'rigid_motion': 'taken out',
            'error': dict(self.error),
            'U_of_largest': self.of_largest,
            'expected_after_compensation': {
                'U': dict(self.expanded),
                'k': self.k,
                'systematic': self.systematic,
                'typical_for': list(self.assumed),
                'presets': list(TYPICAL) if self.assumed else [],
            },
            'noise_and_misfit_alone': {'U': dict(self.observed), 'k': self.k},
        }


def headline_of(
    volume: VolumetricError, budget: Budget, typical: TypicalSystematic | None
) -> Headline:
    """Work out the headline of a calibration.

    Parameters
    ----------
    volume : VolumetricError
        Of the tables; what they do not hold beyond the driven range counts in all uncertainties.
    budget : Budget
        With typical contributions where nothing is declared, see ``typical.with_typical``.
    typical : TypicalSystematic, optional
        None if all is declared.
    """
    variances = budget.variances(volume.rows)
    k, _ = budget.expansion(variances)
    own = np.array([name in OBSERVED for name in budget.names])
    at = int(np.argmax(volume.length))
    longest = budget.variances(volume.length_rows[[at]]).sum() + volume.length_beyond[at]

    def sizes(parts: Array) -> dict[str, float]:
        variance = parts.sum(axis=0).reshape(-1, 3) + volume.beyond
        return length_sizes(k * np.sqrt(variance.sum(axis=1)))

    assumed = typical.missing if typical else ()
    return Headline(
        points=len(volume.grid),
        error=volume.sizes(),
        expanded=sizes(variances),
        observed=sizes(variances[own]),
        of_largest=k * float(np.sqrt(longest)),
        k=k,
        systematic=(
            DECLARED if typical is None else ASSUMED if typical.nothing_declared else PARTLY
        ),
        assumed=assumed,
    )

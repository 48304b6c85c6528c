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

from otf_core.arrays import Array
from otf_core.budget.budget import OBSERVED, Budget
from otf_core.budget.typical import TypicalSystematic
from otf_core.model.expanded import micro_figure, micro_significant, micro_with_expanded
from otf_core.model.presets import TYPICAL
from otf_core.prediction.volumetric import VolumetricError, length_sizes

DECLARED, PARTLY, ASSUMED = 'declared', 'partly typical', 'typical'


@dataclass(frozen=True)
class Expected:
    """Expanded uncertainty of the error vectors on a grid: what compensation will leave.

    Attributes
    ----------
    expanded : mapping of 'mean', 'p95', 'max' to float, m
        Systematic contributions included.
    observed : mapping of the same, m
        Nothing systematic: what is seen to scatter.
    k : float
        Coverage factor of both.
    assumed : tuple of str
        Contributions for which typical values stand, as the budget calls them.
    nothing_declared : bool
        True if machine.yaml declares no contribution at all.
    """

    expanded: Mapping[str, float]
    observed: Mapping[str, float]
    k: float
    assumed: tuple[str, ...]
    nothing_declared: bool

    @property
    def systematic(self) -> str:
        """'declared', 'typical' or 'partly typical': where systematic contributions come from."""
        if not self.assumed:
            return DECLARED
        return ASSUMED if self.nothing_declared else PARTLY

    @property
    def label(self) -> str:
        """The same in a few words."""
        return {
            DECLARED: 'systematic contributions as declared',
            PARTLY: f'systematic contributions as declared; {", ".join(self.assumed)} typical, '
            f'not declared',
            ASSUMED: 'systematic contributions typical, not declared in machine.yaml',
        }[self.systematic]

    @property
    def expanded_words(self) -> str:
        """What is to be expected after compensation."""
        return (
            f'expected after compensation: {self._sizes(self.expanded)} '
            f'(U, k = {self.k:.3g}; {self.label})'
        )

    @property
    def observed_words(self) -> str:
        """The part that holds nothing systematic."""
        return f'noise and misfit of this run alone: {self._sizes(self.observed)} (U)'

    @property
    def forecast_words(self) -> str:
        """The same part before anything is measured."""
        return f'noise of the tracker alone: {self._sizes(self.observed)} (U)'

    def _sizes(self, sizes: Mapping[str, float]) -> str:
        return ', '.join(
            f'{word} {micro_significant(sizes[name])}'
            for word, name in (('mean', 'mean'), ('largest', 'max'))
        )

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, SI."""
        return {
            'expected_after_compensation': {
                'U': dict(self.expanded),
                'k': self.k,
                'systematic': self.systematic,
                'typical_for': list(self.assumed),
                'presets': list(TYPICAL) if self.assumed else [],
            },
            'noise_and_misfit_alone': {'U': dict(self.observed), 'k': self.k},
        }


@dataclass(frozen=True)
class Headline(Expected):
    """Volumetric error and its expanded uncertainty on one grid.

    Attributes
    ----------
    points : int
        Of the grid over the whole volume.
    error : mapping of 'mean', 'p95', 'max' to float, m
        Lengths of the error vectors as the machine stands.
    of_largest : float, m
        Expanded uncertainty of the length of the largest error vector.
    """

    points: int
    error: Mapping[str, float]
    of_largest: float

    @property
    def error_words(self) -> str:
        """The volumetric error as the machine stands."""
        mean = micro_figure(self.error['mean'], self.expanded['mean'])
        largest = micro_with_expanded(self.error['max'], self.of_largest)
        return f'volumetric error as the machine stands: mean {mean}, largest {largest}'

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
            **super().to_dict(),
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

    return Headline(
        expanded=sizes(variances),
        observed=sizes(variances[own]),
        k=k,
        assumed=typical.missing if typical else (),
        nothing_declared=typical is not None and typical.nothing_declared,
        points=len(volume.grid),
        error=volume.sizes(),
        of_largest=k * float(np.sqrt(longest)),
    )

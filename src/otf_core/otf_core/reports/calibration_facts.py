# SPDX-License-Identifier: Apache-2.0
"""What the sections of a calibration's report share: the result, and what is computed once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from otf_core.budget.typical import TypicalSystematic
from otf_core.calibration.result import CalibrationResult
from otf_core.model.machine import Machine
from otf_core.model.tables import ErrorTables
from otf_core.prediction.volumetric import VolumetricError
from otf_core.reports.budget_tables import BudgetLine


@dataclass(frozen=True)
class Facts:
    """A calibration, its budget and where it comes from.

    Attributes
    ----------
    result : CalibrationResult
    lines : tuple of BudgetLine
    provenance : mapping
        Block of that name in error_tables.json.
    """

    result: CalibrationResult
    lines: tuple[BudgetLine, ...]
    provenance: Mapping[str, Any]

    @property
    def tables(self) -> ErrorTables:
        """Error tables."""
        return self.result.tables

    @property
    def machine(self) -> Machine:
        """The machine as set up in the first run."""
        return self.result.tables.machine

    @property
    def typical(self) -> TypicalSystematic | None:
        """What typical systematic contributions would add; None if all are declared."""
        return self.result.typical

    @cached_property
    def by_name(self) -> dict[str, BudgetLine]:
        """Lines of the budget by name."""
        return {line.name: line for line in self.lines}

    @cached_property
    def volume(self) -> VolumetricError:
        """Errors on a grid over the whole volume, with the uncertainty of the headline."""
        own = self.result
        covariance = own.covariance_with_typical
        return VolumetricError(own.tables, covariance, own.prior, own.not_identifiable)

    @cached_property
    def condition_number(self) -> float:
        """Largest over smallest standard uncertainty of what the covariance holds, um and urad."""
        covariance = self.result.covariance
        size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        own = size > 1e-6 * size.max(initial=0.0)
        if not own.any():
            return 1.0
        values = np.linalg.eigvalsh(covariance[np.ix_(own, own)])
        kept = values[values > 1e-12 * values[-1]]
        return float(np.sqrt(kept[-1] / kept[0]))

    @property
    def k_volume(self) -> float:
        """Coverage factor for 95 % of errors in the volume."""
        return self.result.headline.k

    @property
    def both_ways(self) -> bool:
        """True if forward and backward travel differ in this calibration."""
        return any(t.identifiable for t in self.result.reversal.motions.values())

# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.diagnosis.cause_parameters import CauseSize, Curve
from otf_core.diagnosis.place.groups import RunView
from otf_core.diagnosis.place.where import Where
from otf_core.diagnosis.weighing import Unnamed
from otf_core.documents import Document, stated
from otf_core.effects import AppliedEffect
from otf_core.model.machine import Machine
from otf_core.model.provenance import Origin
from otf_core.pieces.finding import Finding
from otf_core.solving.reversal import Reversal

if TYPE_CHECKING:
    from otf_core.diagnosis.document import GapDocument

FORMULA, FREE = 'formula', 'free'
VERDICTS = ('none', 'explained', 'partly_explained', 'unknown')


@dataclass(frozen=True)
class Gap(Document):
    """Size of the gap, root mean square per path piece."""

    measured_um: float = stated('residual of the calibration', 'um')
    simulated_um: float = stated('that of a simulation of the same runs', 'um')
    before_um: float = stated('sqrt(max(0, measured^2 - simulated^2))', 'um')
    after_um: float = stated('with the causes, on legs that they were not fitted on', 'um')
    shrink_percent: float = stated('how much smaller that is', '%')
    shrink_interval_percent: tuple[float, float] = stated('95 % over legs', '%')
    simulated_u_um: float = stated('standard uncertainty of simulated_um', 'um', default=0.0)


@dataclass(frozen=True)
class NamedCause(Document):
    """An effect that was found."""

    effect: str = stated('name in the catalogue')
    axes: tuple[str, ...] = stated('axes that it belongs to')
    parameters: Mapping[str, float] = stated('by name', 'SI')
    u: Mapping[str, float] = stated('standard uncertainty of those that were estimated', 'SI')
    units: Mapping[str, str] = stated('unit of every parameter')
    before_um: float = stated('gap without it, those found before being taken off', 'um')
    after_um: float = stated('gap with it', 'um')
    shrink_percent: float = stated('how much smaller that is', '%')
    confidence: float = stated('that it, or one that it cannot be told from, is the cause')
    indistinguishable_from: tuple[str, ...] = stated('effects that these data cannot tell from it')
    form: str = stated('formula, or free: a smooth function explains more', default=FORMULA)
    departs: str = stated('how a free form departs from the formula', default='')
    curves: tuple[Curve, ...] = stated('of a free form, the largest first', default=())
    direction: str = stated('machine axes along which it displaces the target', default='')
    sizes: tuple[CauseSize, ...] = stated('for a headline, the largest first', default=())


@dataclass(frozen=True)
class AnyCause(Document):
    """Whether anything is missing in the simulation, before any name is given."""

    p_value: float = stated('probability of a residual this large if the simulation were complete')


@dataclass(frozen=True)
class FigureData:
    """What figures show: arrays of every run, and the conditions in words."""

    views: tuple[RunView, ...]
    conditions: Mapping[str, str]


@dataclass(frozen=True)
class Diagnosis:
    """Answer to: where and why does the real run depart from its simulation.

    Attributes
    ----------
    runs : tuple of str
        Names of the recordings.
    verdict : str
        One of ``VERDICTS``.
    sentence : str
        The verdict in words.
    causes : tuple of NamedCause
        First the cause that shrinks the gap most.
    considered : tuple of (effect, log odds)
        Ranking of the last round of the search.
    smallest_found_um : mapping of effect to float
        Root mean square displacement from which an effect would be found.
    contradictions : tuple of Finding
        What the input contradicts, as the calibration says it.
    table_change_um : float
        Mean change of the predicted volumetric error on a lattice by taking the causes off.
    applied : tuple of tuple of AppliedEffect
        For every run the causes, or the one without a name, with their fitted parameters, ready
        for a simulation.
    calibration : CalibrationResult
        What ``calibrate`` gives, and what it gives with the causes taken off.
    origin : tuple of Origin
        The recordings.
    unnamed : Unnamed, optional
        Cause without a name, where the verdict is 'unknown' and something was found.
    """

    runs: tuple[str, ...]
    verdict: str
    sentence: str
    gap: Gap
    causes: tuple[NamedCause, ...]
    unexplained_um: float
    unexplained_where: str
    not_visible: tuple[tuple[str, str], ...]
    where: Where
    considered: tuple[tuple[str, float], ...]
    smallest_found_um: Mapping[str, float]
    contradictions: tuple[Finding, ...]
    table_change_um: float
    applied: tuple[tuple[AppliedEffect, ...], ...]
    calibration: CalibrationResult
    origin: tuple[Origin, ...]
    shown: FigureData
    any_cause: AnyCause
    unnamed: Unnamed | None = None

    @cached_property
    def document(self) -> GapDocument:
        """What gap.json states."""
        from otf_core.diagnosis.document import document_of

        return document_of(self)

    @property
    def machine(self) -> Machine:
        """The machine of the runs."""
        return self.calibration.plain.tables.machine

    @property
    def reversal(self) -> Reversal:
        """Reversal tables of the calibration."""
        return self.calibration.plain.reversal

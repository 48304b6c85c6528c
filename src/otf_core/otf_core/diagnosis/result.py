# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.diagnosis.cause_parameters import CauseSize, Curve
from otf_core.diagnosis.place.groups import RunView
from otf_core.diagnosis.place.where import Where
from otf_core.diagnosis.weighing import Unnamed
from otf_core.effects import AppliedEffect
from otf_core.model.machine import Machine
from otf_core.model.provenance import Origin
from otf_core.pieces.finding import Finding
from otf_core.solving.reversal import Reversal

FORMULA, FREE = 'formula', 'free'
VERDICTS = ('none', 'explained', 'partly_explained', 'unknown')


@dataclass(frozen=True)
class Gap:
    """Size of the gap, micrometres root mean square per path piece.

    Attributes
    ----------
    measured_um, simulated_um : float
        Residual of the calibration, and of that of a simulation of the same runs.
    before_um, after_um : float
        sqrt(max(0, measured^2 - simulated^2)) without and with the causes; ``after`` is judged on
        legs that the causes were not fitted on.
    shrink_interval_percent : tuple of two floats
        95 % interval over legs, with the uncertainty of ``simulated_um``.
    simulated_u_um : float
        Standard uncertainty of ``simulated_um``.
    """

    measured_um: float
    simulated_um: float
    before_um: float
    after_um: float
    shrink_percent: float
    shrink_interval_percent: tuple[float, float]
    simulated_u_um: float = 0.0


@dataclass(frozen=True)
class NamedCause:
    """An effect that was found.

    Attributes
    ----------
    parameters, u : mapping of str to float
        Fitted parameters in SI units with their standard uncertainties (shape parameters have
        none).
    before_um, after_um, shrink_percent : float
        Gap without and with this cause, those found before it being in both.
    form : str
        'formula', or 'free' where a smooth function of inputs explains the data better.
    departs : str
        How the free form departs from the formula, in words; empty for a formula.
    curves : tuple of Curve
        Of the free form, the largest first.
    direction : str
        Machine axes along which it displaces the target, the strongest first, in words.
    sizes : tuple of CauseSize
        What stands for it in a headline, the largest first.
    """

    effect: str
    axes: tuple[str, ...]
    parameters: Mapping[str, float]
    u: Mapping[str, float]
    units: Mapping[str, str]
    before_um: float
    after_um: float
    shrink_percent: float
    confidence: float
    indistinguishable_from: tuple[str, ...]
    form: str = FORMULA
    departs: str = ''
    curves: tuple[Curve, ...] = ()
    direction: str = ''
    sizes: tuple[CauseSize, ...] = ()


@dataclass(frozen=True)
class AnyCause:
    """Whether anything is missing in the simulation, before any name is given.

    Attributes
    ----------
    p_value : float
        Probability of a residual this large if the simulation were complete.
    """

    p_value: float


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

    @property
    def machine(self) -> Machine:
        """The machine of the runs."""
        return self.calibration.plain.tables.machine

    @property
    def reversal(self) -> Reversal:
        """Reversal tables of the calibration."""
        return self.calibration.plain.reversal

# SPDX-License-Identifier: Apache-2.0
"""What a calibration found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.budget import Budget
from otf_core.budget.typical import TypicalSystematic, with_typical
from otf_core.calibration.display import data_frame, figure, one_line, table_html
from otf_core.calibration.headline import Headline
from otf_core.calibration.verdict import Verdict, Verdicts
from otf_core.config import CalibrationConfig
from otf_core.effects.stated_effect import StatedEffect
from otf_core.model.frames import RigidTransform
from otf_core.model.provenance import Origin
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import Misfit, NoiseModel
from otf_core.noise.standstill import Lost
from otf_core.pieces.pieces import Pieces
from otf_core.prediction.absorbed import OffsetBound, offset_bound
from otf_core.prediction.table_prior import MotionPrior
from otf_core.prediction.volumetric import table_places
from otf_core.solving.reversal import Reversal
from otf_core.solving.tabulate import TableCost

GAUGE = (
    'positioning and rotations zero at axis position 0, else at the minimum; '
    'straightness zero at both ends; its slope lies in squareness and alignment'
)


@dataclass(frozen=True)
class Fit:
    """Size and quality of a fit.

    Attributes
    ----------
    samples, used, outliers, pieces : int
    unknowns, rank : int
        Free unknowns after the gauge; combinations of them that the data determine.
    coverage : float
        Driven share of the path length.
    path_mae_before, path_mae_after : float
        Mean perpendicular distance from the path, m: rigidly aligned, and compensated.
    residual_rms : float
        Root mean square of the perpendicular residual, m.
    residual_ratio : float
        Residual of the pieces over the noise specified for single samples, root mean square.
    variance_ratio, correlation_factor : float
        See ``uncertainty.ResidualCheck``.
    inflation : float
        Factor on the covariance that these two call for.
    iterations : int
    """

    samples: int
    used: int
    outliers: int
    pieces: int
    unknowns: int
    rank: int
    coverage: float
    path_mae_before: float
    path_mae_after: float
    residual_rms: float
    residual_ratio: float
    variance_ratio: float
    correlation_factor: float
    inflation: float
    iterations: int


@dataclass(frozen=True)
class RunResult:
    """One run of a calibration.

    Attributes
    ----------
    name : str
        Of the recording.
    target_offset : ndarray, shape (3,), m
    samples : int
    remarks : tuple of str
        What was repaired or left out while the recording was read.
    rate : float
        Hz, usual rate of the samples.
    lost : Lost
        What their stamps say is missing.
    T_machine_tracker : RigidTransform
    noise : NoiseModel
        Noise of single samples as the residuals show it.
    misfit : Misfit
        What the model leaves besides.
    coverage : float
        Driven share of the path length.
    pieces : Pieces
    q : ndarray, shape (p, 3), m
        Nominal position of every piece.
    axes : ndarray, shape (c, p, 3)
        Directions in which deviations are stated: two perpendicular to the path.
    aligned : ndarray, shape (c, p), m
        Rigidly aligned measurement minus path.
    deviation, residual : ndarray, shape (c, p), m
        Measurement in the pose of the solution minus path, before and after compensation.
    normalised : ndarray, shape (c, p)
        Residual over the noise specified for single samples.
    whitened : ndarray, shape (c, p)
        Residual freed of the assumed noise covariance.
    """

    name: str
    target_offset: Array
    samples: int
    remarks: tuple[str, ...]
    rate: float
    lost: Lost
    T_machine_tracker: RigidTransform
    noise: NoiseModel
    misfit: Misfit
    coverage: float
    pieces: Pieces
    q: Array
    axes: Array
    aligned: Array
    deviation: Array
    residual: Array
    normalised: Array
    whitened: Array


@dataclass(frozen=True)
class CalibrationResult:
    """Everything a calibration found.

    Attributes
    ----------
    run_id : str
        Hash of samples, paths, machine and configuration.
    tables : ErrorTables
    covariance : ndarray, shape (m, m)
        Of C0Y, B0Z, A0Z and the nodes of EXX ... ECZ in that order, m and rad: all sources.
    budget : Budget
    runs : tuple of RunResult
    fit : Fit
    headline : Headline
        What is stated first: volumetric error and its expanded uncertainty.
    reversal : Reversal
        How the motions differ between forward and backward travel; ``tables`` hold the mean.
    fraction : int
        Nodes of the tables stand ``table_pitch / fraction`` apart.
    table_costs : mapping of fraction to TableCost
        What straight lines between the nodes cost, for 1 and for the fraction taken.
    prior : mapping of motion or squareness error to MotionPrior
        What is known of them where no data hold them.
    not_identifiable : tuple of str
        Motions and squareness errors the data cannot see.
    typical : TypicalSystematic, optional
        What typical systematic contributions would add; None if all are declared.
    warnings : tuple of str
    failed_gates : tuple of str
        Quality gates of the measurement that failed; empty for a good one.
    config : CalibrationConfig
    origin : tuple of Origin
        The recordings.
    effects : tuple of StatedEffect
        Taken off the runs before the tables were solved for.
    effects_sentence : str
        What was found and done about effects; empty where nobody asked.
    machine_verdict : Verdict, optional
        By the limits of machine.yaml; None without any.
    """

    run_id: str
    tables: ErrorTables
    covariance: Array
    budget: Budget
    runs: tuple[RunResult, ...]
    fit: Fit
    headline: Headline
    reversal: Reversal
    fraction: int
    table_costs: Mapping[int, TableCost]
    prior: Mapping[str, MotionPrior]
    not_identifiable: tuple[str, ...]
    typical: TypicalSystematic | None
    warnings: tuple[str, ...]
    failed_gates: tuple[str, ...]
    config: CalibrationConfig
    origin: tuple[Origin, ...] = ()
    effects: tuple[StatedEffect, ...] = ()
    effects_sentence: str = ''
    machine_verdict: Verdict | None = None

    @property
    def verdicts(self) -> Verdicts:
        """Is the measurement good; is the machine within its limits."""
        return Verdicts(self.failed_gates, self.machine_verdict)

    @cached_property
    def budget_with_typical(self) -> Budget:
        """The budget with typical values where nothing is declared: that of the headline."""
        return with_typical(self.budget, self.typical)

    @cached_property
    def covariance_with_typical(self) -> Array:
        """Its covariance of squareness and nodes, in the order of ``covariance``."""
        return self.covariance if self.typical is None else self.budget_with_typical.covariance

    @cached_property
    def offset_bound(self) -> OffsetBound:
        """Values that hold at the target offset of the measurement only."""
        return offset_bound(self.tables.machine, self.not_identifiable)

    @cached_property
    def expanded(self) -> dict[str, Array]:
        """Expanded uncertainty of squareness errors (1,) and nodes (k,), m and rad.

        That of the headline: with typical values where nothing is declared; zero where a value
        is not identifiable.
        """
        u = np.sqrt(np.maximum(np.diag(self.covariance_with_typical), 0.0))
        variances = self.budget_with_typical.variances()
        found = {}
        for name, place in table_places(self.tables).items():
            k, _ = self.budget_with_typical.expansion(variances[:, place])
            found[name] = k * u[place] * (name not in self.not_identifiable)
        return found

    @property
    def T_machine_tracker(self) -> RigidTransform:
        """Pose of the tracker in the first run."""
        return self.runs[0].T_machine_tracker

    def to_frame(self) -> Any:
        """All errors as a data frame of pandas, SI units, a row for every node.

        Returns
        -------
        pandas.DataFrame
            ``error`` (EXX ... ECZ, C0Y, B0Z, A0Z), ``axis``, ``position`` (m; NaN for squareness),
            ``value`` (m or rad, actual minus nominal), ``unit`` (of the value), ``u`` (standard
            uncertainty of what the budget holds), ``identifiable``, ``U`` and its ``k``: as in
            error_tables.csv. ``U_with_typical`` is U with typical systematic contributions where
            none are declared, ``target_offset`` the offset (m) at which alone a value holds, None
            if at any. ``attrs`` hold machine, chain, run_id and target_offset.

        Raises
        ------
        ConfigError
            If pandas is not installed.

        Examples
        --------
        >>> frame = result.to_frame()  # doctest: +SKIP
        >>> frame[frame.error == 'EXX'].plot('position', 'value', yerr='U')  # doctest: +SKIP
        """
        return data_frame(self)

    def plot(self) -> Any:
        """Draw all error motions with matplotlib: micrometres and microradians over millimetres.

        Bands are expanded uncertainties with the systematic contributions, as in the headline.

        Returns
        -------
        matplotlib.figure.Figure
            Made with pyplot: a notebook shows it, a script calls ``savefig`` on it.

        Raises
        ------
        ConfigError
            If matplotlib is not installed.

        Examples
        --------
        >>> result.plot().savefig('motions.png')  # doctest: +SKIP
        """
        return figure(self)

    def __repr__(self) -> str:
        return one_line(self)

    def _repr_html_(self) -> str:
        return table_html(self)

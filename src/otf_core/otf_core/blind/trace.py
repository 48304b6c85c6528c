# SPDX-License-Identifier: Apache-2.0
"""What a displacement leaves in the residual once tables and poses have followed it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

from otf_core.blind.draw import Trial
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.rows import Rows, build_rows
from otf_core.effects import AppliedEffect, State
from otf_core.model.frames import RigidTransform
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.sim.cell import SimulatedRun
from otf_core.sim.drive import Drive
from otf_core.sim.effects import displaced, run_state
from otf_core.solving.joint import solve_jointly
from otf_core.solving.shape_choice import linear_bases
from otf_core.solving.unknowns import layout
from otf_core.threads import one_thread

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ruler:
    """The runs of a trial without effects, solved: measures what displacements leave.

    Attributes
    ----------
    trial : Trial
    runs : tuple of SimulatedRun
    states : tuple of State
        Of all samples of each run.
    rows : Rows
    """

    trial: Trial
    runs: tuple[SimulatedRun, ...]
    states: tuple[State, ...]
    rows: Rows

    def displacement(self, effects: Sequence[AppliedEffect]) -> list[Array]:
        """Displacement of all samples of each run, (n, 3), m."""
        return [displaced(s, effects) for s in self.states]

    def raw(self, moved: Sequence[Array]) -> float:
        """Root mean square of a displacement itself, m."""
        return float(np.sqrt(np.mean(np.concatenate([(m**2).sum(axis=1) for m in moved]))))

    def left(self, moved: Sequence[Array]) -> Array:
        """Perpendicular displacement of all pieces that tables and poses leave, shape (r,), m."""
        plain = np.concatenate([self._on_pieces(k, m).reshape(-1) for k, m in enumerate(moved)])
        white = self.rows.whiten(plain)
        inner = cho_solve((self.rows.factor, True), self.rows.base.T @ white)
        use = self.rows.use
        unknowns, limit = self.rows.done.unknowns, self.rows.limit
        design = [
            (s.system.design @ unknowns.gauge)[:, use] @ inner * limit for s in self.rows.done.runs
        ]
        return np.asarray(plain - np.concatenate(design))

    def size(self, moved: Sequence[Array]) -> float:
        """Root mean square per piece of what is left, m."""
        left = self.left(moved)
        pieces = sum(len(r.pieces) for r in self.rows.runs)
        return float(np.sqrt(np.sum(left**2) / pieces))

    def snr(self, moved: Sequence[Array]) -> float:
        """Length of what is left, freed of the noise: standard deviations of a perfect test."""
        plain = np.concatenate([self._on_pieces(k, m).reshape(-1) for k, m in enumerate(moved)])
        white = self.rows.whiten(plain)
        return float(np.linalg.norm(self.rows.project(white[:, None])))

    def residual(self, moved: Sequence[Array] | None = None) -> float:
        """Root mean square residual per piece, m, with a displacement added to the runs."""
        rest = np.concatenate([s.residual.reshape(-1) for s in self.rows.done.runs])
        if moved is not None:
            rest = rest + self.left(moved)
        return float(np.sqrt(np.sum(rest**2) / sum(len(r.pieces) for r in self.rows.runs)))

    def _on_pieces(self, k: int, moved: Array) -> Array:
        pieces, solved = self.rows.runs[k].pieces, self.rows.done.runs[k]
        sums = [np.bincount(pieces.piece, moved[pieces.samples, d]) for d in range(3)]
        mean = np.stack(sums, axis=1) / pieces.count[:, None]
        return np.asarray(np.einsum('cij,ij->ci', solved.system.axes, mean))


def sample_state(trial: Trial, k: int, run: SimulatedRun) -> State:
    """State of all samples of a simulated run, as the simulation itself uses it."""
    config = trial.configs[k]
    drive = Drive(trial.plan, config.acceleration)
    time = np.arange(len(run.samples)) / config.rate
    pose = RigidTransform(run.rotation.T, run.place)
    clock = time * (1 + config.clock_drift)
    return run_state(trial.machine, trial.plan, drive, time, clock, pose, run.truth)


def make_ruler(trial: Trial) -> Ruler:
    """Simulate a trial without effects and solve it."""
    config = CalibrationConfig()
    simulated = trial.runs()
    recordings = [Recording(r.samples, trial.plan.path, trial.machine) for r in simulated]
    with one_thread():
        runs, nodes = prepare_runs(recordings, config)
        done = solve_jointly(runs, layout(linear_bases(nodes), len(runs)), config, lambda *_: None)
        rows = build_rows(runs, done, config.unidentifiable_above)
    states = tuple(sample_state(trial, k, r) for k, r in enumerate(simulated))
    return Ruler(trial, tuple(simulated), states, rows)

# SPDX-License-Identifier: Apache-2.0
"""What a displacement leaves in the residual once tables and poses have followed it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.draw import Trial, nodal
from otf_core.blind.observer import Observer, observe
from otf_core.blind.sight import see
from otf_core.effects import AppliedEffect, State
from otf_core.model.frames import RigidTransform
from otf_core.model.kinematics import exact_position
from otf_core.sim.cell import EPOCH_NS, SimulatedRun
from otf_core.sim.drive import Drive
from otf_core.sim.effects import displaced, run_state
from otf_core.sim.signals import signal_courses


@dataclass(frozen=True)
class Ruler:
    """The runs of a trial without effects: measures what displacements leave.

    Attributes
    ----------
    states : tuple of State
        Of all samples of each run.
    """

    trial: Trial
    runs: tuple[SimulatedRun, ...]
    states: tuple[State, ...]
    observer: Observer

    def displacement(self, effects: Sequence[AppliedEffect]) -> list[Array]:
        """Displacement of all samples of each run, (n, 3), m."""
        return [displaced(s, effects) for s in self.states]

    def raw(self, moved: Sequence[Array]) -> float:
        """Root mean square of a displacement itself, m."""
        return float(np.sqrt(np.mean(np.concatenate([(m**2).sum(axis=1) for m in moved]))))

    def size(self, moved: Sequence[Array]) -> float:
        """Root mean square per piece of what tables and poses leave across the path, m."""
        return _per_piece(self.observer.left(moved)[0])

    def snr(self, moved: Sequence[Array]) -> float:
        """Length of what is left, freed of the noise: standard deviations of a perfect test."""
        return self.observer.left(moved)[1]

    def residual(self, moved: Sequence[Array] | None = None) -> float:
        """Root mean square residual per piece, m, with a displacement added to the runs."""
        plain = nodal(self.trial.tables)
        noisy = [
            run.samples.xyz @ run.rotation + run.place - exact_position(plain, state.q)
            for run, state in zip(self.runs, self.states, strict=True)
        ]
        if moved is not None:
            noisy = [a + b for a, b in zip(noisy, moved, strict=True)]
        return _per_piece(self.observer.left(noisy)[0])


def _per_piece(left: Sequence[Array]) -> float:
    both = np.concatenate(left)
    return float(np.sqrt(np.sum(both**2) / len(both)))


def sample_state(trial: Trial, k: int, run: SimulatedRun) -> State:
    """State of all samples of a simulated run, as the simulation itself uses it."""
    config = trial.configs[k]
    drive = Drive(trial.plan, config.acceleration)
    time = np.arange(len(run.samples)) / config.rate
    pose = RigidTransform(run.rotation.T, run.place)
    clock = time * (1 + config.clock_drift)
    beside = signal_courses(run.signals, EPOCH_NS, clock)
    return run_state(trial.machine, trial.plan, drive, time, clock, pose, run.truth, beside)


def make_ruler(trial: Trial) -> Ruler:
    """Simulate a trial without effects."""
    runs = tuple(trial.runs())
    states = tuple(sample_state(trial, k, r) for k, r in enumerate(runs))
    sights = [see(s, c) for s, c in zip(states, trial.configs, strict=True)]
    return Ruler(trial, runs, states, observe(sights, trial.tables))

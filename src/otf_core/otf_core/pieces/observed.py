# SPDX-License-Identifier: Apache-2.0
"""What is observed of a machine in one run: of a recording, or of a plan that nobody drove yet.

Solving, budget and diagnosis need pieces, the place of the tracker, its noise and the shape of the
path; single samples only where ``runs.Run`` is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.signals import Signal
from otf_core.noise.noise_model import Misfit, NoiseModel, misfit_of, scaled
from otf_core.pieces.pieces import Pieces
from otf_core.tracking.curves import PathShape


@dataclass(frozen=True, kw_only=True)
class Observed:
    """Pieces of one run and how they are seen.

    Attributes
    ----------
    machine : Machine
        As set up in this run.
    shape : PathShape
        Corner points and curves of the path as driven.
    pieces : Pieces
    pose : RigidTransform
        Tracker to machine, to start from: fitted rigidly, or of a solution before.
    noise : NoiseModel
        As the standstills of the run show it, else as specified.
    fitted : ndarray, shape (5,), optional
        What the residuals say of noise and misfit, see ``noise_fit.fit_noise``.
    name : str
        Where it comes from, for messages and reports; empty if it needs none.
    late : float, s
        Where a recording was cut: start of this part after that of the recording.
    signals : mapping of str to Signal
        Recorded beside the samples.
    first_ns : int, ns
        Stamp from which the times of the pieces count.
    """

    machine: Machine
    shape: PathShape
    pieces: Pieces
    pose: RigidTransform
    noise: NoiseModel
    fitted: NDArray[np.float64] | None = None
    name: str = ''
    late: float = 0.0
    signals: Mapping[str, Signal] = field(default_factory=dict)
    first_ns: int = 0

    @property
    def leg_starts(self) -> NDArray[np.float64] | None:
        """When every line began from rest, as far as samples tell; see ``tracking.leg_starts``."""
        return None

    @property
    def noise_and_misfit(self) -> tuple[NoiseModel, Misfit]:
        """Noise of single samples, and what the model leaves besides: as far as is known."""
        if self.fitted is None:
            return self.noise, Misfit()
        return scaled(self.noise, self.fitted), misfit_of(self.fitted)


AnyRun = TypeVar('AnyRun', bound=Observed)
"""Runs of recordings stay such where they are moved, thinned or fitted."""

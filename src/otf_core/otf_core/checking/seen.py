# SPDX-License-Identifier: Apache-2.0
"""What can be seen of a recording: every step as far as the one before it led."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.bag_reading import Received
from otf_core.config import CalibrationConfig
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.pieces.finding import Finding
from otf_core.pieces.runs import Run
from otf_core.tracking.alignment import Alignment

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """A recording as far as it could be followed.

    Attributes
    ----------
    name : str
    topics : mapping of topic to message type
    config : CalibrationConfig
    received : Received, optional
    samples : Samples, optional
        In the order of time, unusable ones dropped.
    path : NominalPath, optional
    machine : Machine, optional
    alignment : Alignment, optional
    run : Run, optional
        Reduced to pieces; needs a machine.
    findings : tuple of Finding
        Contradictions in it.
    nodes : mapping of axis to ndarray, m, optional
        Of the tables.
    remarks : tuple of str
        What was mended while it was read.
    said : tuple of str
        How it was read, where that is not as usual.
    refused : mapping of step to str
        Why a step failed: 'bag', 'points', 'path', 'stamps', 'following', 'run'.
    """

    name: str
    topics: Mapping[str, str]
    config: CalibrationConfig
    received: Received | None = None
    samples: Samples | None = None
    path: NominalPath | None = None
    machine: Machine | None = None
    alignment: Alignment | None = None
    run: Run | None = None
    findings: tuple[Finding, ...] = ()
    nodes: Mapping[str, Array] | None = None
    remarks: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    refused: Mapping[str, str] | None = None

    def why(self, step: str) -> str:
        """Why a step failed; empty if it did not, or was not reached."""
        return (self.refused or {}).get(step, '')

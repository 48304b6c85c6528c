# SPDX-License-Identifier: Apache-2.0
"""What is to be calibrated, also while it is not known yet whether the run has ended."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from otf_calibrator.children import Solved
from otf_calibrator.params import CalibratorConfig
from otf_core.bags.sample_order import Screening
from otf_core.config import CalibrationConfig
from otf_core.model.declared_signals import SignalSpec
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.signals import Signal


@dataclass(frozen=True)
class Request:
    """What is to be calibrated.

    ``remarks`` and ``screening`` say what happened to the samples, ``journal`` where they are
    written; the run has ended if the request is ``final``; more may be
    lost than known if ``lost_at_least``.
    """

    samples: Samples
    path: NominalPath
    files: CalibratorConfig
    config: CalibrationConfig
    lost: int
    remarks: tuple[str, ...] = ()
    screening: Screening = field(default_factory=Screening)
    journal: Path | None = None
    final: bool = True
    lost_at_least: bool = False
    signals: Mapping[SignalSpec, Signal] = field(default_factory=dict)


@dataclass
class EarlyCalibration:
    """A calibration that is begun while it is not known yet whether the run has ended.

    The target stands at the end of the path, but not yet for long enough. If it goes on to stand,
    the run has just these samples; if it moves on, the calibration is dropped.

    Attributes
    ----------
    request : Request
        As it will be if the run has ended.
    at_the_end : Future of bool
        Whether its samples follow the path to the end; it goes on only then.
    given_up : Event
        It is not wanted any more.
    solved : CalibrationResult, EffectsCalibration or None
        What it has found; None as well if something was wrong, which is found again.
    """

    request: Request
    at_the_end: Future[bool] = field(default_factory=Future)
    given_up: threading.Event = field(default_factory=threading.Event)
    solved: Solved | None = None

    def is_of(self, request: Request) -> bool:
        """Return whether a calibration of a request would be this one."""
        own = self.request
        return (
            own.path is request.path
            and np.array_equal(own.samples.stamp_ns, request.samples.stamp_ns)
            and np.array_equal(own.samples.xyz, request.samples.xyz)
            and (own.files, own.config, own.remarks, own.final)
            == (request.files, request.config, request.remarks, request.final)
            and vars(own.screening) == vars(request.screening)
        )

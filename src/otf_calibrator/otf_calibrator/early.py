# SPDX-License-Identifier: Apache-2.0
"""A calibration that is begun while it is not known yet whether the run has ended.

The target stands at the end of the path, but not yet for long enough. If it goes on to stand, the
run has just these samples; if it moves on, nobody hears of the calibration.
"""

from __future__ import annotations

import threading
from concurrent.futures import Future
from dataclasses import dataclass, field

import numpy as np

from otf_calibrator.request import Request
from otf_calibrator.solver_task import Solved


@dataclass
class Early:
    """One such calibration.

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
        """Tell whether a calibration of a request would be this one."""
        own = self.request
        return (
            own.path is request.path
            and np.array_equal(own.samples.stamp_ns, request.samples.stamp_ns)
            and np.array_equal(own.samples.xyz, request.samples.xyz)
            and (own.files, own.config, own.remarks, own.final)
            == (request.files, request.config, request.remarks, request.final)
            and vars(own.screening) == vars(request.screening)
        )

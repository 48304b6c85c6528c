# SPDX-License-Identifier: Apache-2.0
"""What is to be calibrated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

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

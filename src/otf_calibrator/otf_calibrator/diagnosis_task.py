# SPDX-License-Identifier: Apache-2.0
"""What the process of a diagnosis is given, and what it says if there is none."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from otf_core.config import CalibrationConfig
from otf_core.pieces.runs import Recording


@dataclass(frozen=True)
class Task:
    """A run to be diagnosed, its name in the report, and where the files go."""

    recording: Recording
    config: CalibrationConfig
    name: str
    folder: Path


@dataclass(frozen=True)
class Failure:
    """Why there is no diagnosis; the code is the exit code of ``./otf diagnose``."""

    exit_code: int
    text: str

# SPDX-License-Identifier: Apache-2.0
"""Calibration with effects taken off: those that a diagnosis finds, or those named in a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from otf_core.calibration.with_effects import EffectsCalibration, calibrate_with_file
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.diagnose import diagnose
from otf_core.diagnosis.twin_residual import Twin
from otf_core.errors import ConfigError
from otf_core.live.stages import Progress
from otf_core.pieces.runs import Recording

AUTO, NONE = 'auto', 'none'


def calibrate_with_effects(
    recordings: Sequence[Recording],
    effects: str,
    twin: Twin,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
    method: str = 'otf',
) -> EffectsCalibration:
    """Calibrate on the fly with effects taken off.

    Parameters
    ----------
    recordings : sequence of Recording
        Runs of one machine.
    effects : str
        'auto': what a diagnosis of these runs finds; else an effects.yaml, see
        ``calibrate_with_file``.
    twin : callable
        Simulates a run again, for the diagnosis: ``sim.twin.twin_recording``.
    progress : callable(stage, fraction), optional
    method : str
        Only 'otf' can do this: stops hold neither direction nor feed.

    Raises
    ------
    ConfigError
        If the file names what cannot be taken off, or for another method.
    InputError
        As ``calibrate_runs``.
    """
    if method != 'otf':
        raise ConfigError(
            f'effects {effects}: cannot be taken off with the method {method}: at stops there is '
            f'neither feed nor direction of travel; use the method otf'
        )
    if effects != AUTO:
        return calibrate_with_file(recordings, effects, config, progress)
    found = diagnose(recordings, twin, (), config, progress)
    done = found.calibration
    if found.verdict != 'unknown':
        return done
    warned = (done.words, *done.result.warnings)
    return replace(done, result=replace(done.result, warnings=warned))

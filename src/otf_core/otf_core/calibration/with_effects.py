# SPDX-License-Identifier: Apache-2.0
"""Calibration with effects taken off beside the one without.

Reversal is left to the calibration's own choice (``reversal_choice``) unless the configuration
says 'none': backlash and direction-dependent tables that a diagnosis finds are not taken off
twice. A file that names one of them switches that choice off. Nodes too far apart are nothing to
take off: it is the tables that follow finer. Each effect says which it is (``belongs_to``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from otf_core.calibration.calibrate import assemble
from otf_core.calibration.correction import Corrected, calibrate_without
from otf_core.calibration.result import CalibrationResult
from otf_core.calibration.solved import solve_recordings
from otf_core.config import CalibrationConfig
from otf_core.effects import AppliedEffect, BelongsTo
from otf_core.effects.effects_yaml import read_effects
from otf_core.effects.removable_effect import Taken, taken
from otf_core.effects.stated_effect import FILE
from otf_core.errors import ConfigError
from otf_core.live.stages import Progress, silent
from otf_core.pieces.runs import Recording
from otf_core.threads import in_one_thread


@dataclass(frozen=True)
class EffectsCalibration:
    """A calibration with effects taken off, and the one without beside it.

    Attributes
    ----------
    result : CalibrationResult
        What counts: with effects taken off if there were any.
    plain : CalibrationResult
        Without; the same if there were none.
    applied : tuple of tuple of AppliedEffect
        What was taken off, run by run.
    """

    result: CalibrationResult
    plain: CalibrationResult
    applied: tuple[tuple[AppliedEffect, ...], ...]

    @property
    def words(self) -> str:
        """What was done, in a sentence."""
        return self.result.effects_sentence


def beside_plain(
    plain: CalibrationResult,
    corrected: Corrected | None,
    taking: Sequence[Taken],
    words: str,
    warnings: Sequence[str] = (),
) -> EffectsCalibration:
    """Put a calibration with effects taken off beside the one without.

    Parameters
    ----------
    plain : CalibrationResult
    corrected : Corrected, optional
        See ``calibrate_without``; None where nothing was taken off.
    taking : sequence of Taken
        Effects that were taken off.
    words : str
        What was done, in a sentence.
    warnings : sequence of str
        Put before those of the result.
    """
    if corrected is None:
        result = replace(plain, warnings=(*warnings, *plain.warnings), effects_sentence=words)
        return EffectsCalibration(result, plain, tuple(() for _ in plain.runs))
    result = corrected.result
    of_plain = (f'of the plain calibration: {gate}' for gate in plain.failed_gates)
    result = replace(
        result, warnings=(*warnings, *of_plain, *result.warnings), effects_sentence=words
    )
    applied = tuple(
        tuple(AppliedEffect(one.effect, own) for one, own in zip(taking, run, strict=True))
        for run in corrected.parameters
    )
    return EffectsCalibration(result, plain, applied)


@in_one_thread
def calibrate_with_file(
    recordings: Sequence[Recording],
    file: str,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> EffectsCalibration:
    """Calibrate on the fly with the effects of a file taken off.

    Parameters
    ----------
    recordings : sequence of Recording
        Runs of one machine.
    file : str
        An effects.yaml, whose coefficients are estimated anew where the data see them and whose
        shapes (time constant, period) are held.
    config : CalibrationConfig, optional
    progress : callable(stage, fraction), optional

    Raises
    ------
    ConfigError
        If the file names what cannot be taken off.
    InputError
        As ``calibrate_runs``.
    """
    config = config or CalibrationConfig()
    progress = progress or silent
    named = _named(file, recordings)
    solved = solve_recordings(recordings, config, progress)
    taking = [taken([one] * len(solved.runs), FILE) for one in named]
    own = config
    if any(one.effect.belongs_to is BelongsTo.REVERSAL for one in taking):
        own = replace(config, reversal='none')
    words = f'Effects of {file} taken off: {listed(taking)}.'
    plain = assemble(solved.solution, config, solved.findings)
    corrected = calibrate_without(solved, taking, own, progress)
    return beside_plain(plain, corrected, taking, words)


def _named(file: str, recordings: Sequence[Recording]) -> list[AppliedEffect]:
    """Effects of a file that can be taken off; ConfigError says why one cannot."""
    found = read_effects(file, recordings[0].machine)
    for one in found:
        if one.effect.belongs_to is BelongsTo.NOISE:
            raise ConfigError(
                f'{file}: {one.effect.name}: noise displaces nothing that could be taken off; its '
                f'size is found from the data in every calibration; leave it out of the file'
            )
        if one.effect.belongs_to is BelongsTo.TABLES:
            raise ConfigError(
                f'{file}: {one.effect.name}: belongs into the tables and is not taken off; the '
                f'tables follow the data as finely as they call for; leave it out of the file'
            )
    if not found:
        raise ConfigError(f'{file}: names no effect; leave --effects out for plain tables')
    return list(found)


def listed(taking: Sequence[Taken]) -> str:
    """Names of the effects, each once."""
    return ', '.join(dict.fromkeys(one.effect.name for one in taking))

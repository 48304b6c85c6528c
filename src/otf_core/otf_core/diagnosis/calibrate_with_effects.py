# SPDX-License-Identifier: Apache-2.0
"""Calibration with effects taken off: those that a diagnosis finds, or those named in a file.

Reversal is left to the calibration's own choice (``reversal_choice``) unless the configuration
says 'none': backlash and direction-dependent tables that a diagnosis finds are not taken off
twice. A file that names one of them switches that choice off. Nodes too far apart are nothing to
take off: it is the tables that follow finer. Each effect says which it is (``belongs_to``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from otf_core.calibration.calibrate import calibrate_runs
from otf_core.calibration.correction import calibrate_without
from otf_core.calibration.result import CalibrationResult
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.complete import diagnose
from otf_core.diagnosis.diagnose import Twin
from otf_core.diagnosis.engine.search import Cause
from otf_core.diagnosis.result import Diagnosis
from otf_core.effects import AppliedEffect, BelongsTo, names_of
from otf_core.effects.effects_yaml import read_effects
from otf_core.effects.stated import FILE, FOUND
from otf_core.effects.taken import Taken, taken
from otf_core.errors import ConfigError
from otf_core.pieces.runs import Recording
from otf_core.solving.joint import Progress
from otf_core.threads import in_one_thread

AUTO, NONE = 'auto', 'none'
SURE = 0.99
"""Least confidence of a cause that is taken off without a warning."""


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
    words : str
        What was done, in a sentence.
    """

    result: CalibrationResult
    plain: CalibrationResult
    applied: tuple[tuple[AppliedEffect, ...], ...]
    words: str


@in_one_thread
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
        'auto': what a diagnosis of these runs finds; else an effects.yaml, whose coefficients are
        estimated anew where the data see them and whose shapes (time constant, period) are held.
    twin : callable
        Simulates a run again, for the diagnosis: ``sim.twin.twin_recording``.
    config : CalibrationConfig, optional
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
    config = config or CalibrationConfig()
    progress = progress or (lambda stage, fraction: None)
    named = [] if effects == AUTO else _named(effects, recordings)
    plain = calibrate_runs(recordings, config, progress)
    warnings: list[str] = []
    if effects == AUTO:
        names = [r.name or f'run {k}' for k, r in enumerate(recordings, start=1)]
        diagnosis, data = diagnose(recordings, names, twin, (), config, progress)
        chosen = [taken(list(found), FOUND) for found in zip(*data.applied, strict=True)]
        taking, warnings = _to_take(chosen, data.findings.causes, config)
        words = _words(diagnosis, taking)
        if diagnosis.verdict == 'unknown':
            warnings.append(words)
    else:
        taking = [taken([one] * len(recordings), FILE) for one in named]
        words = f'Effects of {effects} taken off: {_listed(taking)}.'
        if any(one.effect.belongs_to is BelongsTo.REVERSAL for one in taking):
            config = replace(config, reversal='none')
    if not taking:
        result = replace(plain, warnings=(*warnings, *plain.warnings))
        return EffectsCalibration(result, plain, tuple(() for _ in recordings), words)
    warnings += [f'of the plain calibration: {gate}' for gate in plain.failed_gates]
    result, found = calibrate_without(recordings, taking, config, progress)
    result = replace(result, warnings=(*warnings, *result.warnings))
    applied = tuple(tuple(e.applied(k) for e in found.effects) for k in range(len(recordings)))
    return EffectsCalibration(result, plain, applied, words)


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


def _to_take(
    found: Sequence[Taken], causes: Sequence[Cause], config: CalibrationConfig
) -> tuple[list[Taken], list[str]]:
    """What of the causes found is taken off, and warnings."""
    left = names_of(BelongsTo.TABLES)
    if config.reversal != 'none':
        left |= names_of(BelongsTo.REVERSAL)
    taking, warnings = [], []
    for one, cause in zip(found, causes, strict=True):
        if one.effect.name in left:
            continue
        taking.append(one)
        said = []
        if cause.confidence < SURE:
            said.append(f'with a confidence of {cause.confidence:.2f} only')
        others = [n for n in cause.indistinguishable if n not in left]
        if others:
            said.append(
                f'not told from {" or ".join(others)}; tables with that taken off instead may '
                f'differ by more than u'
            )
        if said:
            warnings.append(f'effect taken off: {one.effect.name}, {"; ".join(said)}')
    return taking, warnings


def _listed(taking: Sequence[Taken]) -> str:
    return ', '.join(dict.fromkeys(one.effect.name for one in taking))


def _words(diagnosis: Diagnosis, taking: Sequence[Taken]) -> str:
    """What the diagnosis said and what was done."""
    if taking:
        return f'{diagnosis.sentence} Taken off: {_listed(taking)}.'
    return f'{diagnosis.sentence} No effect was taken off.'

# SPDX-License-Identifier: Apache-2.0
"""The calibration with the causes of a diagnosis taken off."""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.calibration.calibrate import SolvedRecordings
from otf_core.calibration.result import CalibrationResult
from otf_core.calibration.with_effects import EffectsCalibration, listed, take_off
from otf_core.config import CalibrationConfig
from otf_core.effects import AppliedEffect, BelongsTo, names_of
from otf_core.effects.stated import FOUND
from otf_core.effects.taken import Taken, taken

Told = tuple[float, tuple[str, ...]]
"""Confidence in a cause, and what it is not told from."""
SURE = 0.99
"""Least confidence of a cause that is taken off without a warning."""


def with_causes(
    solved: SolvedRecordings,
    plain: CalibrationResult,
    told: Sequence[Told],
    applied: Sequence[Sequence[AppliedEffect]],
    config: CalibrationConfig,
    sentence: str,
) -> EffectsCalibration:
    """Calibrate with causes taken off.

    Parameters
    ----------
    solved : SolvedRecordings
    plain : CalibrationResult
        Of these.
    told : sequence of Told
        Of every cause.
    applied : sequence of sequence of AppliedEffect
        For every run the causes with their parameters.
    config : CalibrationConfig
    sentence : str
        What the diagnosis says.
    """
    chosen = [taken(list(found), FOUND) for found in zip(*applied, strict=True)]
    taking, warnings = _to_take(chosen, told, config)
    done = f'Taken off: {listed(taking)}.' if taking else 'No effect was taken off.'
    return take_off(solved, plain, taking, config, f'{sentence} {done}', warnings)


def _to_take(
    found: Sequence[Taken], told: Sequence[Told], config: CalibrationConfig
) -> tuple[list[Taken], list[str]]:
    """What of the causes found is taken off, and warnings."""
    left, names = {BelongsTo.TABLES}, names_of(BelongsTo.TABLES)
    if config.reversal != 'none':
        left.add(BelongsTo.REVERSAL)
        names |= names_of(BelongsTo.REVERSAL)
    taking, warnings = [], []
    for one, (confidence, indistinguishable) in zip(found, told, strict=True):
        if one.effect.belongs_to in left:
            continue
        taking.append(one)
        said = []
        if confidence < SURE:
            said.append(f'with a confidence of {confidence:.2f} only')
        others = [n for n in indistinguishable if n not in names]
        if others:
            said.append(
                f'not told from {" or ".join(others)}; tables with that taken off instead may '
                f'differ by more than u'
            )
        if said:
            warnings.append(f'effect taken off: {one.effect.name}, {"; ".join(said)}')
    return taking, warnings

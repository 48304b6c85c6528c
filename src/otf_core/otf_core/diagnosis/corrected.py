# SPDX-License-Identifier: Apache-2.0
"""The calibration with the causes of a diagnosis taken off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from otf_core.calibration.correction import Corrected, calibrate_without
from otf_core.calibration.result import CalibrationResult
from otf_core.calibration.solved import Examined
from otf_core.calibration.with_effects import EffectsCalibration, beside_plain, listed
from otf_core.config import CalibrationConfig
from otf_core.effects import AppliedEffect, BelongsTo, names_of
from otf_core.effects.stated import FOUND
from otf_core.effects.taken import Taken, taken

Told = tuple[float, tuple[str, ...]]
"""Confidence in a cause, and what it is not told from."""
SURE = 0.99
"""Least confidence of a cause that is taken off without a warning."""


@dataclass(frozen=True)
class FoundCauses:
    """Causes of a diagnosis, as a calibration takes them off.

    Attributes
    ----------
    told : tuple of Told
        Of every cause.
    applied : tuple of tuple of AppliedEffect
        For every run the causes with their parameters.
    """

    told: tuple[Told, ...]
    applied: tuple[tuple[AppliedEffect, ...], ...]

    def to_take(self, config: CalibrationConfig) -> tuple[list[Taken], list[str]]:
        """What is taken off, and warnings."""
        chosen = [taken(list(found), FOUND) for found in zip(*self.applied, strict=True)]
        return _to_take(chosen, self.told, config)


def without_causes(
    examined: Examined, causes: FoundCauses, config: CalibrationConfig
) -> Corrected | None:
    """Calibrate with causes taken off; None if none is."""
    taking, _ = causes.to_take(config)
    return calibrate_without(examined, taking, config) if taking else None


def with_causes(
    plain: CalibrationResult,
    corrected: Corrected | None,
    causes: FoundCauses,
    config: CalibrationConfig,
    sentence: str,
) -> EffectsCalibration:
    """Put the calibration with causes taken off beside the one without.

    Parameters
    ----------
    plain : CalibrationResult
    corrected : Corrected, optional
        See ``without_causes``.
    causes : FoundCauses
    config : CalibrationConfig
    sentence : str
        What the diagnosis says.
    """
    taking, warnings = causes.to_take(config)
    done = f'Taken off: {listed(taking)}.' if taking else 'No effect was taken off.'
    words = f'{sentence} {done}'
    return beside_plain(plain, corrected, taking, words, warnings)


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

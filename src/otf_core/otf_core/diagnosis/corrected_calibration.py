# SPDX-License-Identifier: Apache-2.0
"""The calibration with the causes of a diagnosis taken off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from otf_core.calibration.calibrate import ExaminedRecordings
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.calibration.with_effects import (
    CorrectedCalibration,
    calibrate_without_effects,
    effect_names,
    pair_with_plain,
)
from otf_core.config import CalibrationConfig
from otf_core.effects import AppliedEffect, BelongsTo, names_of
from otf_core.effects.removable_effect import FOUND, RemovableEffect, removable_effect
from otf_core.solving.reversal import Reversal

SURE = 0.99
"""Least confidence of a cause that is taken off without a warning."""


@dataclass(frozen=True)
class CauseWords:
    """What a diagnosis says of a cause.

    Attributes
    ----------
    words : str
        Its name with its axes.
    """

    confidence: float
    indistinguishable: tuple[str, ...]
    words: str
    axes: tuple[str, ...] = ()


@dataclass(frozen=True)
class CausesToRemove:
    """Causes of a diagnosis, as a calibration takes them off.

    Attributes
    ----------
    told : tuple of CauseWords
        Of every cause.
    applied : tuple of tuple of AppliedEffect
        For every run the causes with their parameters.
    followed : tuple of str
        Names of further causes, which the functions of the calibration follow.
    """

    told: tuple[CauseWords, ...]
    applied: tuple[tuple[AppliedEffect, ...], ...]
    followed: tuple[str, ...] = ()

    def to_take(self, config: CalibrationConfig) -> tuple[list[RemovableEffect], list[str]]:
        """What is taken off, and warnings."""
        chosen = [
            removable_effect(list(in_runs), FOUND) for in_runs in zip(*self.applied, strict=True)
        ]
        return _to_take(chosen, self.told, config)

    def stays(self, config: CalibrationConfig, plain: CalibrationResult) -> list[str]:
        """What is not taken off and what holds it, in words.

        Parameters
        ----------
        plain : CalibrationResult
            With nothing taken off.
        """
        words = [f'{name} is in the error tables, which follow it' for name in self.followed]
        held_by_tables = _kinds_held(config)
        for one, description in zip(self.applied[0], self.told, strict=True):
            if one.effect.belongs_to not in held_by_tables:
                continue
            if one.effect.belongs_to is BelongsTo.TABLES:
                words.append(f'{description.words} is in the error tables, which follow it')
            elif plain.reversal.model == 'none':
                words.append(
                    f'{description.words} belongs in reversal tables, which this calibration '
                    f'does not have'
                )
            else:
                held = in_reversal_tables(plain.reversal, description.axes)
                words.append(f'{description.words} is in the reversal tables{held}')
        return words


def calibrate_without_causes(
    examined: ExaminedRecordings, causes: CausesToRemove, config: CalibrationConfig
) -> CorrectedCalibration | None:
    """Calibrate with causes taken off; None if none is."""
    taking, _ = causes.to_take(config)
    return calibrate_without_effects(examined, taking, config) if taking else None


def pair_with_corrected(
    plain: CalibrationResult,
    corrected: CorrectedCalibration | None,
    causes: CausesToRemove,
    config: CalibrationConfig,
    sentence: str,
) -> CalibrationResult:
    """Put the calibration with causes taken off beside the one without.

    Parameters
    ----------
    corrected : CorrectedCalibration, optional
        See ``calibrate_without_causes``.
    sentence : str
        What the diagnosis says.
    """
    taking, warnings = causes.to_take(config)
    words = f'{sentence} {_done_words(taking, causes.stays(config, plain))}'
    return pair_with_plain(plain, corrected, taking, words, warnings)


def in_reversal_tables(reversal: Reversal, axes: Sequence[str]) -> str:
    """What reversal tables hold of the backlash of axes, and why a diagnosis states another value.

    Empty where they hold nothing of it.
    """
    held = {a: reversal.backlash[a] for a in axes if a in reversal.backlash}
    if not held:
        return ''
    sizes = ', '.join(f'{axis} {backlash.words}' for axis, backlash in held.items())
    return (
        f' ({sizes}, k = 2: there every motion of every axis may reverse, while the diagnosis '
        f'fits only the causes it names)'
    )


def _done_words(taking: Sequence[RemovableEffect], stays: Sequence[str]) -> str:
    """What was taken off, and what holds the rest."""
    held = '; '.join(stays)
    held = held[:1].upper() + held[1:]
    if taking:
        return f'Removed: {effect_names(taking).replace("_", " ")}.' + (
            f' {held}.' if held else ''
        )
    return f'{held}; nothing else to remove.' if held else 'No effect was removed.'


def _kinds_held(config: CalibrationConfig) -> set[BelongsTo]:
    """Kinds of effects that a calibration holds by itself."""
    return {BelongsTo.TABLES} | ({BelongsTo.REVERSAL} if config.reversal != 'none' else set())


def _to_take(
    removable: Sequence[RemovableEffect],
    descriptions: Sequence[CauseWords],
    config: CalibrationConfig,
) -> tuple[list[RemovableEffect], list[str]]:
    """What of the causes found is taken off, and warnings."""
    held_by_tables = _kinds_held(config)
    names = {name for kind in held_by_tables for name in names_of(kind)}
    taking, warnings = [], []
    for one, about in zip(removable, descriptions, strict=True):
        if one.effect.belongs_to in held_by_tables:
            continue
        taking.append(one)
        said = []
        if about.confidence < SURE:
            said.append(f'with a confidence of {about.confidence:.2f} only')
        others = [n for n in about.indistinguishable if n not in names]
        if others:
            said.append(
                f'indistinguishable from {" or ".join(others)}; tables with that removed '
                f'instead may differ by more than u'
            )
        if said:
            warnings.append(f'effect removed: {one.effect.name}, {"; ".join(said)}')
    return taking, warnings

# SPDX-License-Identifier: Apache-2.0
"""Sizes recovered: parameters within their uncertainty, gap and shrink against the truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.blind.cases import trial_of
from otf_core.blind.natures import OUTSIDE
from otf_core.blind.observer import Ruler, make_ruler
from otf_core.effects import REGISTRY, AppliedEffect, BelongsTo
from otf_core.effects.effects_yaml import read_effects
from otf_core.errors import ConfigError
from otf_core.files.strict_yaml import read_json
from otf_core.model.machine import Machine
from otf_core.sim.effects import total_displacement

EFFECTS, LATER_EFFECTS = 'effects.yaml', 'effects_run_{}.yaml'
"""Files that an answer lies in beside gap.json; later runs have one where theirs differ."""
LOOSE_SHAPE = ('order', 'until')
SAME_SHAPE = 0.02
"""Shapes that agree to this share count as the same."""
TIME_CONSTANT = 'tau'


@dataclass(frozen=True)
class Recovery:
    """What one answer says about sizes, and what is true.

    Attributes
    ----------
    deviations : tuple of float
        (Fitted less true) parameters over their standard uncertainties.
    shrink_percent : float
        Predicted by the answer.
    achieved_percent : float
        Share of what the effects leave that the fitted causes really take away.
    left_snr : float
        Standard deviations at which a perfect observer tells the fitted causes from the truth.
    """

    cell: str
    deviations: tuple[float, ...]
    gap_um: float
    true_gap_um: float
    shrink_percent: float
    interval_percent: tuple[float, float]
    achieved_percent: float
    left_snr: float = 0.0

    @property
    def covered(self) -> bool:
        """Whether the interval of the shrink holds the truth."""
        low, high = self.interval_percent
        return low - 1e-9 <= self.achieved_percent <= high + 1e-9


def _comparable(effect: str, true: Mapping[str, float], fitted: Mapping[str, float]) -> bool:
    """Return whether two sets of parameters have the same shape."""
    names = [n for n in REGISTRY[effect].shape_names if n not in LOOSE_SHAPE]
    if TIME_CONSTANT in names:
        return False
    try:
        shape = REGISTRY[effect].complete_shape(true)
    except ConfigError:
        return False
    return all(
        n in fitted and abs(fitted[n] - shape[n]) <= SAME_SHAPE * abs(shape[n]) for n in names
    )


def _is_free(cause: Mapping[str, Any]) -> bool:
    return cause.get('form') == 'free'


def parameter_deviations(
    parts: Sequence[Mapping[str, Any]], causes: Sequence[Mapping[str, Any]]
) -> tuple[float, ...]:
    """Deviations of all parameters of rightly named causes, in standard uncertainties."""
    deviations = []
    for part in parts:
        for cause in causes:
            if cause['effect'] != part['effect'] or not cause['u'] or _is_free(cause):
                continue
            true, fitted = part['parameters'], cause['parameters']
            if _comparable(part['effect'], true, fitted):
                deviations += [
                    (fitted[n] - true.get(n, 0.0)) / u for n, u in cause['u'].items() if u > 0
                ]
    return tuple(deviations)


def ruler_of(entry: Mapping[str, Any]) -> Ruler:
    """Build the cell of an entry of the key again, without effects."""
    rng = np.random.default_rng([entry['seed'], entry['number'] + 1])
    return make_ruler(trial_of(entry['kind'], entry['cell'], rng))


def _hidden(parts: Sequence[Mapping[str, Any]]) -> list[AppliedEffect]:
    every = {**REGISTRY, **OUTSIDE}
    return _displacing(AppliedEffect(every[p['effect']], p['parameters']) for p in parts)


def _displacing(applied: Iterable[AppliedEffect]) -> list[AppliedEffect]:
    return [a for a in applied if a.effect.belongs_to is not BelongsTo.NOISE]


def fitted_effects(folder: Path, machine: Machine, runs: int) -> list[list[AppliedEffect]]:
    """Effects of every run as an answer wrote them for a simulation; none where it names none."""
    files = [folder / EFFECTS, *(folder / LATER_EFFECTS.format(k + 1) for k in range(1, runs))]
    by_run: list[list[AppliedEffect]] = []
    for file in files:
        if file.exists():
            by_run.append(_displacing(read_effects(file, machine)))
        else:
            by_run.append(by_run[0] if by_run else [])
    return by_run


def recover(
    entry: Mapping[str, Any],
    answer: Mapping[str, Any],
    fitted: Sequence[Sequence[AppliedEffect]],
    ruler: Ruler,
) -> Recovery:
    """Compare one answer with the truth.

    Parameters
    ----------
    entry : mapping
        Of the key.
    answer : mapping
        gap.json.
    fitted : sequence of sequence of AppliedEffect
        What it found, of every run: causes in any form, or one without a name.
    ruler : Ruler
        Of the cell.
    """
    true = ruler.displacement(_hidden(entry['parts']))
    said = [total_displacement(s, one) for s, one in zip(ruler.states, fitted, strict=True)]
    difference = [t - f for t, f in zip(true, said, strict=True)]
    before = max(ruler.size(true), 1e-12)
    shrink = answer.get('unnamed') or answer['gap']
    true_gap = max(0.0, entry['measured_um'] ** 2 - entry['simulated_um'] ** 2) ** 0.5
    return Recovery(
        cell=entry['cell'],
        deviations=parameter_deviations(entry['parts'], answer['causes']),
        gap_um=answer['gap']['before_um'],
        true_gap_um=true_gap,
        shrink_percent=shrink['shrink_percent'],
        interval_percent=tuple(shrink['shrink_interval_percent']),
        achieved_percent=float(100.0 * max(0.0, 1.0 - ruler.size(difference) / before)),
        left_snr=ruler.snr(difference),
    )


def recover_cell(entry: Mapping[str, Any], answer: str) -> dict[str, Any]:
    """Compare the answer in a file with the truth, as plain data; see ``recover``."""
    ruler = ruler_of(entry)
    fitted = fitted_effects(Path(answer).parent, ruler.trial.machine, len(ruler.states))
    return asdict(recover(entry, read_json(answer), fitted, ruler))


def recovery_from(data: Mapping[str, Any]) -> Recovery:
    """Return what ``recover_cell`` found."""
    pairs = {name: tuple(data[name]) for name in ('deviations', 'interval_percent')}
    return Recovery(**{**data, **pairs})

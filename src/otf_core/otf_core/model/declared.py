# SPDX-License-Identifier: Apache-2.0
"""Standard uncertainties that no run shows, as declared in machine.yaml under ``uncertainty``.

All keys are optional. What is not declared is not in the budget, which says so. Classes of
trackers and workshops (``presets``) declare many at once; keys that are given win.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from otf_core.files.strict_yaml import Fields
from otf_core.model.presets import WORKSHOPS, chosen, systematic_of

KEYS: dict[str, tuple[str, float]] = {
    'tracker_scale': ('m/m', 1e-3),
    'air_temperature': ('K', 50.0),
    'air_pressure': ('Pa', 2e4),
    'tracker_range_offset': ('m', 1e-2),
    'tracker_offset': ('m', 1e-2),
    'tracker_angle': ('rad', 1e-2),
    'machine_temperature': ('K', 50.0),
    'expansion': ('1/K', 1e-3),
    'target_offset': ('m', 1.0),
}
"""Unit and largest value of every key."""
TARGET_OFFSET = 'target_offset'


def declarable_keys(rotary: bool) -> tuple[str, ...]:
    """Keys of a machine without or with rotary axes, which states it by ``targets: tool: u``."""
    return tuple(k for k in KEYS if not (rotary and k == TARGET_OFFSET))


@dataclass(frozen=True)
class DeclaredUncertainty:
    """Declared standard uncertainties (k = 1).

    Attributes
    ----------
    values : mapping of key to float
        By the keys and in the units of ``KEYS``; ``expansion`` is the expansion coefficient that
        ``machine_temperature`` acts through. Zero declares that there is nothing.
    preset : str, optional
        Class of workshop that some of the values come from.
    """

    values: Mapping[str, float]
    preset: str | None = None

    def get(self, *keys: str) -> tuple[float, ...]:
        """Return the values of some keys; zero where not declared."""
        return tuple(self.values.get(k, 0.0) for k in keys)


def declared_from_fields(fields: Fields, tracker: str | None = None) -> DeclaredUncertainty:
    """Read the section.

    Parameters
    ----------
    tracker : str, optional
        Class of tracker that is named in the section ``tracker``.

    Raises
    ------
    ConfigError
        Names the key that is unknown, mistyped or out of range.
    """
    values = {} if tracker is None else systematic_of(tracker)
    preset = fields.text('preset') if fields.has('preset') else None
    if preset is not None:
        values.update(chosen(WORKSHOPS, preset, f'{fields.where}: preset').values)
    for key, (unit, high) in KEYS.items():
        if fields.has(key):
            values[key] = fields.number(key, low=0.0, high=high, unit=unit, closed=True)
    fields.done(known=(*KEYS, 'preset'))
    for one, other in (('machine_temperature', 'expansion'), ('expansion', 'machine_temperature')):
        if one in values and other not in values:
            fields.fail(other, f'missing; {one} needs it')
    return DeclaredUncertainty({k: values[k] for k in KEYS if k in values}, preset)

# SPDX-License-Identifier: Apache-2.0
"""Classes of trackers and of workshops: typical standard uncertainties, each with its source.

``tracker: {preset: NAME}`` and ``uncertainty: {preset: NAME}`` in machine.yaml take them; keys
given in addition to a preset take precedence. A stated limit +/- a is taken as rectangular, u = a
/ sqrt(3) (GUM 4.3.7). They do not replace the certificate of the tracker or a thermometer.

Names and values of presets do not change, so results that refer to one stay reproducible.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from otf_core.errors import ConfigError

AT500 = (
    'limits of a recent absolute tracker, Leica AT500 user manual, section 2.8.2 (ISO 10360-10): '
    'distance meter 10 um + 0.3 um/m, R0 5 um, across the beam 15 um + 6 um/m; results are '
    'typically half of the limits'
)
RECORDED = (
    'recordings at rest, docs/uncertainty.md: along the beam 0.3 um to 0.9 um, across it 1.0 urad '
    'to 1.9 urad in calm air, 3.1 urad to 4.2 urad in turbulent air'
)
LTD800 = (
    'LTD800 data sheet, coordinates at rest, 2 sigma: 25 um up to 2.5 m, 10 um/m beyond; used '
    'as offset and as angle, so somewhat too large in between'
)
INTERFEROMETER = 'interferometer 0.5 um/m, as stated by manufacturers'
GRADIENT = (
    'vertical gradients of 2 K/m still count as comfortable (BG ETEM, Messung der '
    'Lufttemperatur): 0.5 m from the thermometer is 1 K, 1.5 m is 3 K'
)
STEEL = 'steel 11.7e-6 1/K, cast iron 10e-6 to 12e-6 1/K'


@dataclass(frozen=True)
class Preset:
    """One class.

    Attributes
    ----------
    what : str
        In words.
    values : mapping of key to float
        Keys of the section ``uncertainty``; for trackers ``u_range`` and ``u_angle`` as well.
    sources : tuple of str
        Where the values come from, and what was assumed.
    """

    what: str
    values: Mapping[str, float]
    sources: tuple[str, ...]


TRACKERS: dict[str, Preset] = {
    'absolute-interferometer': Preset(
        'recent absolute tracker, measuring with its interferometer in calm air, recently '
        'compensated and two-face checked',
        {
            'u_range': 0.5e-6,
            'u_angle': 1.5e-6,
            'tracker_scale': 0.3e-6,
            'tracker_range_offset': 2.9e-6,
            'tracker_offset': 4.3e-6,
            'tracker_angle': 1.7e-6,
        },
        (RECORDED, INTERFEROMETER, AT500, 'across the beam half of the limit, R0 in full'),
    ),
    'absolute-distance-meter': Preset(
        'recent absolute tracker, measuring with its absolute distance meter in workshop air',
        {
            'u_range': 1.0e-6,
            'u_angle': 3.5e-6,
            'tracker_scale': 0.2e-6,
            'tracker_range_offset': 6.5e-6,
            'tracker_offset': 8.7e-6,
            'tracker_angle': 3.5e-6,
        },
        (RECORDED, AT500, 'limits in full; u_range is assumed: measure it with otf noise'),
    ),
    'ltd-class': Preset(
        'older interferometer tracker of the LTD class, reset at the bird bath',
        {
            'u_range': 0.7e-6,
            'u_angle': 3.5e-6,
            'tracker_scale': 0.3e-6,
            'tracker_range_offset': 5.8e-6,
            'tracker_offset': 12.5e-6,
            'tracker_angle': 5.0e-6,
        },
        (RECORDED, LTD800, INTERFEROMETER, 'bird bath known to 10 um is assumed'),
    ),
}

WORKSHOPS: dict[str, Preset] = {
    'laboratory': Preset(
        'temperature-controlled room, machine at thermal equilibrium, weather read during the run',
        {
            'air_temperature': 0.17,
            'air_pressure': 60.0,
            'machine_temperature': 0.17,
            'expansion': 11.7e-6,
            'target_offset': 0.12e-3,
        },
        (
            'assumed limits: air and machine 0.3 K, pressure 1 hPa, target offset measured to '
            '0.2 mm',
            STEEL,
        ),
    ),
    'workshop': Preset(
        'ordinary workshop: heated, doors closed, weather read once, machine thermometer',
        {
            'air_temperature': 0.6,
            'air_pressure': 120.0,
            'machine_temperature': 1.2,
            'expansion': 11.7e-6,
            'target_offset': 0.6e-3,
        },
        (
            GRADIENT,
            'assumed limits: air 1 K, machine 2 K, pressure 2 hPa, target offset from a drawing '
            'or a ruler to 1 mm',
            STEEL,
        ),
    ),
    'hall': Preset(
        'hall without climate control: open doors, large heights, weather of the day',
        {
            'air_temperature': 1.7,
            'air_pressure': 290.0,
            'machine_temperature': 2.9,
            'expansion': 11.7e-6,
            'target_offset': 0.6e-3,
        },
        (GRADIENT, 'assumed limits: air 3 K, machine 5 K, pressure 5 hPa, target 1 mm', STEEL),
    ),
}

TYPICAL = ('absolute-interferometer', 'workshop')
"""Tracker and workshop whose values stand for contributions that nobody declared."""
NOISE = ('u_range', 'u_angle')
"""Keys of a tracker preset that belong to the section ``tracker``."""


def chosen(presets: Mapping[str, Preset], name: str, where: str) -> Preset:
    """Return a preset by its name; ConfigError lists those that exist."""
    if name not in presets:
        raise ConfigError(f"{where}: '{name}' is not a preset; known here: {', '.join(presets)}")
    return presets[name]


def systematic_of(tracker: str) -> dict[str, float]:
    """Systematic contributions of a class of trackers, by the keys of ``uncertainty``."""
    return {k: v for k, v in TRACKERS[tracker].values.items() if k not in NOISE}


def typical_values() -> dict[str, float]:
    """Typical standard uncertainty of every systematic contribution, by key."""
    tracker, workshop = TYPICAL
    return {**systematic_of(tracker), **WORKSHOPS[workshop].values}

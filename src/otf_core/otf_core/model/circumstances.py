# SPDX-License-Identifier: Apache-2.0
"""What a report states and no recording holds: instrument, conditions, certificate.

These sections are optional in machine.yaml, and so are their keys; nothing is computed from them.
Units are in the names; temperature is in degrees Celsius, as on thermometers (REP 103).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from otf_core.files.strict_yaml import Fields

INSTRUMENT = {
    'model': 'model',
    'serial': 'serial number',
    'firmware': 'firmware',
    'calibrated': 'last calibration',
    'mpe': 'maximum permissible error',
    'mode': 'distance meter (IFM or ADM)',
    'target': 'target (SMR)',
}
CERTIFICATE = {
    'number': 'certificate number',
    'customer': 'customer',
    'order': 'order',
    'laboratory': 'issued by',
    'manufacturer': 'manufacturer of the machine',
    'machine_serial': 'serial number of the machine',
}
TEXTS = {'operator': 'operator', 'place': 'place', 'remark': 'remark'}
NUMBERS: dict[str, tuple[str, str, float, float]] = {
    'air_temperature_celsius': ('air temperature', '\N{DEGREE SIGN}C', -50.0, 100.0),
    'air_pressure_pa': ('air pressure', 'Pa', 3e4, 1.2e5),
    'relative_humidity_percent': ('relative humidity', '%', 0.0, 100.0),
    'material_temperature_celsius': (
        'temperature of the machine',
        '\N{DEGREE SIGN}C',
        -50.0,
        100.0,
    ),
    'warm_up_s': ('warm-up time', 's', 0.0, 1e7),
}
"""In words, unit, least and largest value."""


@dataclass(frozen=True)
class Circumstances:
    """As stated in machine.yaml, by the keys of ``INSTRUMENT``, ``TEXTS`` and ``NUMBERS``.

    ``certificate``: by those of ``CERTIFICATE``, for the certificate alone.
    """

    instrument: Mapping[str, str] = field(default_factory=dict)
    conditions: Mapping[str, str | float] = field(default_factory=dict)
    certificate: Mapping[str, str] = field(default_factory=dict)


def circumstances_from_fields(
    instrument: Fields, conditions: Fields, certificate: Fields
) -> Circumstances:
    """Read the three sections.

    Raises
    ------
    ConfigError
        Names the key that is unknown, mistyped or out of range.
    """
    own = {key: instrument.text(key) for key in INSTRUMENT if instrument.has(key)}
    instrument.done(known=INSTRUMENT)
    stated: dict[str, str | float] = {
        key: conditions.text(key) for key in TEXTS if conditions.has(key)
    }
    for key, (_, unit, low, high) in NUMBERS.items():
        if conditions.has(key):
            stated[key] = conditions.number(key, low=low, high=high, unit=unit, closed=True)
    conditions.done(known=(*TEXTS, *NUMBERS))
    named = {key: certificate.text(key) for key in CERTIFICATE if certificate.has(key)}
    certificate.done(known=CERTIFICATE)
    return Circumstances(own, stated, named)

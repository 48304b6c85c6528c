# SPDX-License-Identifier: Apache-2.0
"""Optional sections of machine.yaml, see docs/machine.md.

- ``limits``: what a calibration is judged by.
- ``uncertainty``: standard uncertainties that no run shows. What is not declared is not in the
  budget, which says so; classes of trackers and workshops (``presets``) declare many at once, and
  keys that are given win.
- ``instrument``, ``conditions``, ``certificate``: what a report states and no recording holds.
- ``signals``: what is recorded beside the samples, in which unit, which effects it may drive.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from otf_core.files.strict_yaml import Fields
from otf_core.model.motions import unit_of
from otf_core.model.presets import WORKSHOPS, chosen, systematic_of

VOLUMETRIC, UNCERTAINTY = 'volumetric_error', 'uncertainty'
LARGEST = 1e-2
"""m or rad; as high as a limit may be."""


@dataclass(frozen=True)
class Limits:
    """Limits by their keys, m or rad, see ``limit_unit``."""

    values: Mapping[str, float]


def limit_unit(key: str) -> str:
    """Unit of a limit."""
    return 'm' if key in (VOLUMETRIC, UNCERTAINTY) else unit_of(key)


def limits_from_fields(fields: Fields, errors: Sequence[str]) -> Limits:
    """Read the section of a machine with these motions, squareness and location errors.

    Raises
    ------
    ConfigError
        Names the key that is unknown, mistyped or out of range.
    """
    keys = (VOLUMETRIC, UNCERTAINTY, *map(str, errors))
    values = {
        key: fields.number(key, low=0.0, high=LARGEST, unit=limit_unit(key))
        for key in keys
        if fields.has(key)
    }
    fields.done(known=keys)
    return Limits(values)


DECLARABLE: dict[str, tuple[str, float]] = {
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
OF_BEAM = ('tracker_range_offset', 'tracker_offset', 'tracker_angle')
"""Contributions that depend on where the beam begins."""


def declarable_keys(rotary: bool) -> tuple[str, ...]:
    """Keys of a machine without or with rotary axes, which states it by ``targets: tool: u``."""
    return tuple(k for k in DECLARABLE if not (rotary and k == TARGET_OFFSET))


@dataclass(frozen=True)
class DeclaredUncertainty:
    """Declared standard uncertainties (k = 1).

    Attributes
    ----------
    values : mapping of key to float
        By the keys and in the units of ``DECLARABLE``; ``expansion`` is the expansion coefficient
        that ``machine_temperature`` acts through. Zero declares that there is nothing.
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
    for key, (unit, high) in DECLARABLE.items():
        if fields.has(key):
            values[key] = fields.number(key, low=0.0, high=high, unit=unit, closed=True)
    fields.done(known=(*DECLARABLE, 'preset'))
    for one, other in (('machine_temperature', 'expansion'), ('expansion', 'machine_temperature')):
        if one in values and other not in values:
            fields.fail(other, f'missing; {one} needs it')
    return DeclaredUncertainty({k: values[k] for k in DECLARABLE if k in values}, preset)


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


SIGNAL_PREFIX = 'signal:'
"""Before the name of a signal among the inputs of effects."""
SIGNAL_FIELDS = {
    'sensor_msgs/msg/Temperature': 'temperature',
    'sensor_msgs/msg/FluidPressure': 'fluid_pressure',
    'sensor_msgs/msg/RelativeHumidity': 'relative_humidity',
    'std_msgs/msg/Float64': 'data',
    'std_msgs/msg/Float32': 'data',
    'std_msgs/msg/Int32': 'data',
    'std_msgs/msg/Bool': 'data',
}
"""Messages with one number, and its field: those that are simulated and taken live."""
USUAL_SIGNAL = 'sensor_msgs/msg/Temperature'
SIGNAL_DRIVEN = ('thermal_axis_expansion', 'thermal_structure_drift', 'tracker_pose_drift')
"""Effects that may follow a signal."""


@dataclass(frozen=True)
class SignalSpec:
    """One declared signal.

    Attributes
    ----------
    topic, field : str
        An empty field stands for the number of the message.
    unit : str
        As the topic has it; empty for a state.
    type : str
        Of its messages where they are simulated or taken live; empty for any other message,
        whose ``field`` is read from bags alone.
    acts_on : tuple of str
        Effects that may follow it.
    """

    topic: str
    field: str
    unit: str
    type: str
    acts_on: tuple[str, ...]

    @property
    def wanted(self) -> str:
        """``TOPIC`` or ``TOPIC:field``."""
        return f'{self.topic}:{self.field}' if self.field else self.topic

    @property
    def name(self) -> str:
        """As an input of effects."""
        return SIGNAL_PREFIX + self.wanted

    def to_dict(self) -> dict[str, Any]:
        """Layout of machine.yaml."""
        data: dict[str, Any] = {'unit': self.unit} if self.unit else {}
        data |= {'type': self.type} if self.type else {}
        return {**data, 'acts_on': list(self.acts_on)}


def signals_from_fields(fields: Fields, names: list[str]) -> tuple[SignalSpec, ...]:
    """Read the section.

    Raises
    ------
    ConfigError
        Names the key that is unknown or holds what it must not.
    """
    return tuple(_signal(fields, name) for name in names)


def _signal(fields: Fields, name: str) -> SignalSpec:
    topic, _, field = name.partition(':')
    if not topic.startswith('/') or topic == '/':
        fields.fail(name, 'expected the name of a topic that begins with /, or TOPIC:FIELD')
    own = fields.mapping(name)
    unit = own.text('unit') if own.has('unit') else ''
    kind = own.text('type') if own.has('type') else '' if field else USUAL_SIGNAL
    if kind and kind not in SIGNAL_FIELDS:
        possible = ', '.join(SIGNAL_FIELDS)
        own.fail('type', f"'{kind}' is not a message with one number; possible: {possible}; "
                         f'for any other type give the field alone, for bags')  # fmt: skip
    if kind and field not in ('', SIGNAL_FIELDS[kind]):
        own.fail('type', f'{kind} has no field {field}; its number is {SIGNAL_FIELDS[kind]}')
    acts_on = own.take('acts_on') if own.has('acts_on') else list(SIGNAL_DRIVEN)
    if (
        not isinstance(acts_on, list)
        or not acts_on
        or not all(a in SIGNAL_DRIVEN for a in acts_on)
    ):
        own.fail('acts_on', f'expected a list of effects among {", ".join(SIGNAL_DRIVEN)}')
    own.done(known=('unit', 'type', 'acts_on'))
    return SignalSpec(topic, field, unit, kind, tuple(dict.fromkeys(acts_on)))

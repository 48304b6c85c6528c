# SPDX-License-Identifier: Apache-2.0
"""Signals of a cell as declared in machine.yaml under ``signals``.

What is recorded beside the samples, in which unit, and which effects it may drive:
``/spindle/temperature: {unit: degC, acts_on: [thermal_structure_drift]}``; the key is the topic,
or the topic and a field as in ``/machine/state:coolant``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from otf_core.files.strict_yaml import Fields

HEAD = 'signal:'
"""Before the name of a signal among the inputs of effects."""
PLAIN = {
    'sensor_msgs/msg/Temperature': 'temperature',
    'sensor_msgs/msg/FluidPressure': 'fluid_pressure',
    'sensor_msgs/msg/RelativeHumidity': 'relative_humidity',
    'std_msgs/msg/Float64': 'data',
    'std_msgs/msg/Float32': 'data',
    'std_msgs/msg/Int32': 'data',
    'std_msgs/msg/Bool': 'data',
}
"""Messages with one number, and its field: those that are simulated and taken live."""
USUAL = 'sensor_msgs/msg/Temperature'
DRIVEN = ('thermal_axis_expansion', 'thermal_structure_drift', 'tracker_pose_drift')
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
        return HEAD + self.wanted

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
    return tuple(_one(fields, name) for name in names)


def _one(fields: Fields, name: str) -> SignalSpec:
    topic, _, field = name.partition(':')
    if not topic.startswith('/') or topic == '/':
        fields.fail(name, 'expected the name of a topic that begins with /, or TOPIC:FIELD')
    own = fields.mapping(name)
    unit = own.text('unit') if own.has('unit') else ''
    kind = own.text('type') if own.has('type') else '' if field else USUAL
    if kind and kind not in PLAIN:
        possible = ', '.join(PLAIN)
        own.fail('type', f"'{kind}' is not a message with one number; possible: {possible}; "
                         f'for any other type give the field alone, for bags')  # fmt: skip
    if kind and field not in ('', PLAIN[kind]):
        own.fail('type', f'{kind} has no field {field}; its number is {PLAIN[kind]}')
    acts_on = own.take('acts_on') if own.has('acts_on') else list(DRIVEN)
    if not isinstance(acts_on, list) or not acts_on or not all(a in DRIVEN for a in acts_on):
        own.fail('acts_on', f'expected a list of effects among {", ".join(DRIVEN)}')
    own.done(known=('unit', 'type', 'acts_on'))
    return SignalSpec(topic, field, unit, kind, tuple(dict.fromkeys(acts_on)))

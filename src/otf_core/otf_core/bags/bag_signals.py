# SPDX-License-Identifier: Apache-2.0
"""Signals of a bag: one number of every message of a topic; and messages that hold them."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.bags.bag_source import locate
from otf_core.bags.cdr import (
    SECOND_NS,
    decode_message,
    encode_header,
    encode_message,
    message_types,
)
from otf_core.bags.rosbag2_metadata import Topic
from otf_core.errors import ConfigError, InputError
from otf_core.model.sections import SIGNAL_FIELDS, SIGNAL_PREFIX, SignalSpec
from otf_core.model.signals import Signal

# Signals as messages of their topics; those without a header count at their time of reception.

BOOL, INT = 'std_msgs/msg/Bool', 'std_msgs/msg/Int32'


def topic_of(spec: SignalSpec) -> Topic:
    """Topic of a declared signal."""
    return Topic(spec.topic, spec.type, '', 100, 'volatile')


def signal_messages(signals: Mapping[SignalSpec, Signal]) -> list[tuple[int, Topic, bytes]]:
    """Stamp in ns, topic and serialized message of every value, in the order of stamps."""
    messages = []
    for spec, signal in signals.items():
        topic, kind = topic_of(spec), message_types().types[spec.type]
        fields = kind.__dataclass_fields__
        for stamp, value in zip(signal.stamp_ns.tolist(), signal.value.tolist(), strict=True):
            given: dict[str, Any] = {SIGNAL_FIELDS[spec.type]: _message_number(spec.type, value)}
            if 'header' in fields:
                given |= {'header': encode_header(stamp, ''), 'variance': 0.0}
            messages.append((stamp, topic, encode_message(kind(**given))))
    return sorted(messages, key=lambda entry: entry[0])


def _message_number(kind: str, value: float) -> Any:
    if kind == BOOL:
        return bool(value)
    return round(value) if kind == INT else float(value)


# Signals of a bag: one number of every message of a topic.
#
# ``TOPIC`` or ``TOPIC:field``, the field in dots as in ``status.temperature``; without it the
# first of ``FIELDS`` that the message has. A message with a header counts at its stamp, any other
# at the time of reception.

_log = logging.getLogger(__name__)

FIELDS = (
    'temperature', 'fluid_pressure', 'relative_humidity', 'illuminance', 'range', 'data',
)  # fmt: skip
"""Of sensor_msgs and std_msgs messages with one number."""
MIN_MESSAGES = 3
"""Messages that make a signal."""


def read_signals(source: str | Path, declared: Sequence[SignalSpec]) -> dict[str, Signal]:
    """Read the signals of a machine from a bag, by name.

    The log says which of them the bag lacks, and which have too few messages.

    Raises
    ------
    ConfigError
        If a field is not in its messages or no number.
    """
    if not declared:
        return {}
    held: dict[str, str] = {}
    for _ in locate(source).messages({}, held, []):
        pass
    for one in declared:
        if one.topic not in held:
            _log.warning('%s: no topic %s, a signal of the machine', source, one.topic)
    rows = _rows(source, [one.wanted for one in declared if one.topic in held], held)
    return {
        SIGNAL_PREFIX + name: signal_of(f'{source}: {name}', own)
        for name, own in rows.items()
        if _enough(f'{source}: {name}', own)
    }


def _rows(
    source: str | Path, names: Sequence[str], held: dict[str, str]
) -> dict[str, list[tuple[int, float]]]:
    """Stamps, ns, and numbers of every name, in the order in which they were received."""
    rows: dict[str, list[tuple[int, float]]] = {name: [] for name in names}
    topics = {name.partition(':')[0] for name in names}
    plain = {t: (held[t],) for t in topics if held[t] in SIGNAL_FIELDS}
    known = (
        (block.topic, decode_message(data, held[block.topic]), received)
        for block in (locate(source).messages(plain, {}, []) if plain else ())
        for received, data in block
    )
    for topic, message, received in chain(known, _other_messages(source, topics - set(plain))):
        for name in names:
            if name.partition(':')[0] == topic:
                number = _number(message, name, held[topic])
                rows[name].append((_stamp(message, received), number))
    return rows


def _other_messages(source: str | Path, topics: set[str]) -> Iterator[tuple[str, Any, int]]:
    """Messages that the bag itself describes; InputError if it is not whole."""
    if not topics:
        return
    from rosbags.highlevel import AnyReader, AnyReaderError

    try:
        with AnyReader([Path(source)], default_typestore=message_types()) as reader:
            chosen = [c for c in reader.connections if c.topic in topics]
            for connection, received, raw in reader.messages(connections=chosen):
                yield connection.topic, reader.deserialize(raw, connection.msgtype), received
    except AnyReaderError as error:
        raise InputError(
            f'{source}: {", ".join(sorted(topics))} cannot be read ({error}); such messages are '
            f'read from whole bags alone'
        ) from None


def _enough(where: str, rows: Sequence[tuple[int, float]]) -> bool:
    """Return whether a declared signal can be used; the log says if not."""
    if len({stamp for stamp, value in rows if np.isfinite(value)}) >= MIN_MESSAGES:
        return True
    _log.warning('%s: too few messages for a signal', where)
    return False


def _stamp(message: Any, received: int) -> int:
    header = getattr(message, 'header', None)
    if header is None:
        return received
    return int(header.stamp.sec) * SECOND_NS + int(header.stamp.nanosec)


def _number(message: Any, name: str, kind: str) -> float:
    field = name.partition(':')[2]
    if not field:
        field = next((f for f in FIELDS if hasattr(message, f)), '')
    value = message
    for part in field.split('.') if field else ():
        value = getattr(value, part, None)
    if not field or not isinstance(value, (bool, int, float, np.number, np.bool_)):
        raise ConfigError(
            f'signals: {name}: name a field of {kind} that is one number, as TOPIC:field'
        )
    return float(value)


def signal_of(where: str, rows: Sequence[tuple[int, float]]) -> Signal:
    """Signal of stamps, ns, and values; InputError if there are too few."""
    ordered = dict(sorted(row for row in rows if np.isfinite(row[1])))
    if len(ordered) < MIN_MESSAGES:
        raise InputError(f'{where}: {len(ordered)} usable messages; a signal needs {MIN_MESSAGES}')
    stamps = np.array(list(ordered), dtype=np.int64)
    return Signal(stamps, np.array(list(ordered.values())))

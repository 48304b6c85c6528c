# SPDX-License-Identifier: Apache-2.0
"""Signals of a bag: one number of every message of a topic.

``TOPIC`` or ``TOPIC:field``, the field in dots as in ``status.temperature``; without it the first
of ``FIELDS`` that the message has. A message with a header counts at its stamp, any other at the
time of reception.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.errors import ConfigError, InputError
from otf_core.model.signals import Signal

FIELDS = (
    'temperature', 'fluid_pressure', 'relative_humidity', 'illuminance', 'range', 'data',
)  # fmt: skip
"""Of sensor_msgs and std_msgs messages with one number."""
FEWEST = 3
"""Messages that make a signal."""
HEAD = 'signal:'


def read_signals(source: str | Path, wanted: Sequence[str]) -> dict[str, Signal]:
    """Read signals of a bag.

    Parameters
    ----------
    source : str or Path
    wanted : sequence of str
        ``TOPIC`` or ``TOPIC:field``.

    Returns
    -------
    dict of str to Signal
        By ``signal:`` and what was wanted.

    Raises
    ------
    ConfigError
        If a topic is not in the bag, a field not in its messages or no number.
    InputError
        If there are too few messages.
    """
    if not wanted:
        return {}
    from rosbags.highlevel import AnyReader  # 0.2 s
    from rosbags.typesys import Stores, get_typestore

    rows: dict[str, list[tuple[int, float]]] = {name: [] for name in wanted}
    topics = {name: name.partition(':')[0] for name in wanted}
    with AnyReader([Path(source)], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for topic in topics.values():
            if topic not in reader.topics:
                known = ', '.join(sorted(reader.topics))
                raise ConfigError(f'--signal: {source} has no topic {topic}; it has {known}')
        chosen = [c for c in reader.connections if c.topic in topics.values()]
        for connection, received, raw in reader.messages(connections=chosen):
            message = reader.deserialize(raw, connection.msgtype)
            for name, topic in topics.items():
                if topic == connection.topic:
                    stamp = _stamp(message, received)
                    rows[name].append((stamp, _number(message, name, connection.msgtype)))
    return {HEAD + name: _signal(str(source), name, own) for name, own in rows.items()}


def _stamp(message: Any, received: int) -> int:
    header = getattr(message, 'header', None)
    if header is None:
        return received
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _number(message: Any, name: str, kind: str) -> float:
    field = name.partition(':')[2]
    if not field:
        field = next((f for f in FIELDS if hasattr(message, f)), '')
    found = message
    for part in field.split('.') if field else ():
        found = getattr(found, part, None)
    if not field or not isinstance(found, (bool, int, float, np.number, np.bool_)):
        raise ConfigError(
            f'--signal: {name}: name a field of {kind} that is one number, as TOPIC:field'
        )
    return float(found)


def _signal(source: str, name: str, rows: Sequence[tuple[int, float]]) -> Signal:
    ordered = dict(sorted(row for row in rows if np.isfinite(row[1])))
    if len(ordered) < FEWEST:
        raise InputError(
            f'{source}: {name}: {len(ordered)} usable messages; a signal needs {FEWEST}'
        )
    stamps = np.array(list(ordered), dtype=np.int64)
    return Signal(stamps, np.array(list(ordered.values())))

# SPDX-License-Identifier: Apache-2.0
"""Signals as messages of their topics; those without a header count at their time of reception."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from otf_core.bags.cdr import SECOND_NS
from otf_core.bags.topics import Topic
from otf_core.model.declared_signals import PLAIN, SignalSpec
from otf_core.model.signals import Signal

BOOL, INT = 'std_msgs/msg/Bool', 'std_msgs/msg/Int32'


def topic_of(spec: SignalSpec) -> Topic:
    """Topic of a declared signal."""
    return Topic(spec.topic, spec.type, '', 100, 'volatile')


def signal_messages(
    signals: Mapping[SignalSpec, Signal], store: Any
) -> list[tuple[int, Topic, bytes]]:
    """Stamp in ns, topic and serialized message of every value, in the order of stamps."""
    found = []
    for spec, signal in signals.items():
        topic, kind = topic_of(spec), store.types[spec.type]
        fields = kind.__dataclass_fields__
        for stamp, value in zip(signal.stamp_ns.tolist(), signal.value.tolist(), strict=True):
            given: dict[str, Any] = {PLAIN[spec.type]: _number(spec.type, value)}
            if 'header' in fields:
                given |= {'header': _header(store, stamp), 'variance': 0.0}
            data = bytes(store.serialize_cdr(kind(**given), spec.type))
            found.append((stamp, topic, data))
    return sorted(found, key=lambda entry: entry[0])


def _number(kind: str, value: float) -> Any:
    if kind == BOOL:
        return bool(value)
    return round(value) if kind == INT else float(value)


def _header(store: Any, stamp: int) -> Any:
    time = store.types['builtin_interfaces/msg/Time']
    seconds, rest = divmod(int(np.int64(stamp)), SECOND_NS)
    return store.types['std_msgs/msg/Header'](time(seconds, rest), '')

# SPDX-License-Identifier: Apache-2.0
"""``/diagnostics`` in the way of diagnostic_updater, which is no part of every installation."""

from __future__ import annotations

import resource
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from otf_ros import convert, qos
from otf_ros.timers import create_timer

PERIOD = 1.0
"""s"""
LITTLE_DISK, NO_DISK = 1e9, 5e7
"""byte; less is warned of, and an error."""
MUCH_MEMORY = 4e9
"""byte; a calibration of a day's samples needs less."""


class Level(Enum):
    """How bad it is."""

    OK = DiagnosticStatus.OK
    WARN = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR
    STALE = DiagnosticStatus.STALE


@dataclass(frozen=True)
class Finding:
    """What a task has found.

    Attributes
    ----------
    text : str
        One sentence.
    values : mapping of str to anything
        Names with units, and their values.
    """

    level: Level
    text: str
    values: Mapping[str, object] = field(default_factory=dict)


class Diagnostics:
    """Publishes what all tasks find, once per second.

    Parameters
    ----------
    hardware : callable
        Returns what the node works with, such as name and serial number of a device.
    tasks : mapping of str to callable
        Each returns a Finding, at once.
    """

    def __init__(
        self, node: Node, hardware: Callable[[], str], tasks: Mapping[str, Callable[[], Finding]]
    ) -> None:
        self._node, self._hardware, self._tasks = node, hardware, tasks
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', qos.DIAGNOSTICS)
        create_timer(node, PERIOD, self._publish)

    def _publish(self) -> None:
        name, hardware = self._node.get_fully_qualified_name().lstrip('/'), self._hardware()
        message = DiagnosticArray()
        message.header.stamp = convert.now(self._node)
        for task, look in self._tasks.items():
            finding = look()
            message.status.append(
                DiagnosticStatus(
                    level=finding.level.value,
                    name=f'{name}: {task}',
                    message=finding.text,
                    hardware_id=hardware,
                    values=[KeyValue(key=k, value=_text(v)) for k, v in finding.values.items()],
                )
            )
        self._publisher.publish(message)


def _text(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def memory() -> Finding:
    """Memory of this process."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    with open('/proc/self/statm', encoding='ascii') as statm:
        now = int(statm.read().split()[1]) * resource.getpagesize()
    level = Level.WARN if now > MUCH_MEMORY else Level.OK
    return Finding(
        level, f'{now / 1e6:.0f} MB', {'resident [MB]': now / 1e6, 'most [MB]': most / 1e6}
    )


def disk(folder: str) -> Finding:
    """Room left where a folder is or will be."""
    place = Path(folder).absolute()
    try:
        free = shutil.disk_usage(next(p for p in (place, *place.parents) if p.exists())).free
    except OSError as error:
        return Finding(Level.WARN, f'{folder}: {error.strerror}')
    values = {'folder': folder, 'free [MB]': free / 1e6}
    if free < NO_DISK:
        return Finding(Level.ERROR, f'{folder}: only {free / 1e6:.0f} MB left', values)
    level = Level.WARN if free < LITTLE_DISK else Level.OK
    return Finding(level, f'{free / 1e9:.1f} GB left', values)

# SPDX-License-Identifier: Apache-2.0
"""A node under test: in the process of the test, seen by nobody else."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from otf_ros.app import running_ros

PATIENCE = 30.0
"""s"""
ALONE = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'}
"""Nodes of other processes are not discovered, so tests may run side by side."""
SMALL_MACHINE: dict[str, Any] = {
    'name': 'small',
    'chain': 'w-b-X-Y-Z-t',
    'axes': {
        name: {'min': low, 'max': low + 0.3, 'table_pitch': 0.1}
        for name, low in {'X': 0.0, 'Y': 0.0, 'Z': -0.3}.items()
    },
    'target_offset': [0.0, 0.0, -0.15],
    'tracker': {'u_range': 0.5e-6, 'u_angle': 2.0e-6},
}
"""Content of a machine.yaml."""


class Bench:
    """A node and an ear beside it.

    Attributes
    ----------
    node : rclpy.node.Node
        Under test.
    ear : rclpy.node.Node
        For what the test publishes, hears and asks.
    """

    def __init__(self, factory: Callable[[], Node]) -> None:
        self.ear = rclpy.create_node('test_ear')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.ear)
        self.node = factory()
        self._executor.add_node(self.node)

    def wait(self, condition: Callable[[], object], what: str = 'it') -> None:
        """Serve callbacks until a condition holds; AssertionError if that takes too long."""
        until = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < until, f'waited {PATIENCE:g} s for {what}'
            self._executor.spin_once(timeout_sec=0.05)

    def heard(self, kind: type, topic: str, profile: Any) -> list[Any]:
        """Return the list that messages of a topic are put into."""
        messages: list[Any] = []
        self.ear.create_subscription(kind, topic, messages.append, profile)
        return messages

    def call(self, kind: Any, name: str, request: Any = None) -> Any:
        """Call a service of the node and return its answer."""
        client = self.ear.create_client(kind, name)
        self.wait(client.service_is_ready, name)
        future = client.call_async(request or kind.Request())
        self.wait(future.done, f'the answer of {name}')
        return future.result()

    def close(self) -> None:
        """End both nodes."""
        if hasattr(self.node, 'close'):
            self.node.close()
        self._executor.shutdown()
        self.node.destroy_node()
        self.ear.destroy_node()


@contextmanager
def node_on_bench(factory: Callable[[], Node], **parameters: object) -> Iterator[Bench]:
    """Run a node with parameters as long as the context lasts.

    Parameters
    ----------
    **parameters : object
        ROS parameters by name.
    """
    words = [w for name, value in parameters.items() for w in ('-p', f'{name}:={_text(value)}')]
    arguments = ['--ros-args', *words] if words else []
    with mock.patch.dict(os.environ, ALONE), running_ros(arguments):
        bench = Bench(factory)
        try:
            yield bench
        finally:
            bench.close()


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)

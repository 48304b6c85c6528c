# SPDX-License-Identifier: Apache-2.0
"""Follows a calibration from outside: shows its progress, ends with its result."""

from __future__ import annotations

import sys
import time

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from otf_bringup.processes import NodeProcess
from otf_core.errors import OtfError
from otf_msgs.msg import CalibrationResult, CalibratorState
from otf_ros import qos
from otf_ros.app import EndRequest, running_ros

PATIENCE = 60.0
"""s; without any progress for so long, something is wrong."""
LINE_PERIOD = 5.0
"""s between progress lines where they cannot be overwritten."""


class GraphError(OtfError):
    """A node ended too early or nothing moves; the message has the end of its log."""


class Monitor(Node):
    """Listens to state and result of the calibrator."""

    def __init__(self) -> None:
        super().__init__('demo_monitor')
        self.state: CalibratorState | None = None
        self.result: CalibrationResult | None = None
        self.create_subscription(CalibratorState, 'calibrator/state', self._on_state, qos.STATUS)
        self.create_subscription(
            CalibrationResult, 'calibrator/result', self._on_result, qos.RESULT
        )

    @property
    def ended(self) -> bool:
        """True once state and result both say how it ended."""
        over = (CalibratorState.DONE, CalibratorState.FAILED)
        return self.result is not None and self.state is not None and self.state.state in over

    def _on_state(self, message: CalibratorState) -> None:
        self.state = message

    def _on_result(self, message: CalibrationResult) -> None:
        self.result = message


def follow(domain: int, nodes: list[NodeProcess]) -> CalibrationResult:
    """Show progress until there is a result, and return it.

    Parameters
    ----------
    domain : int
        ROS domain of the nodes.
    nodes : list of NodeProcess
        Watched: the end of one of them ends this.

    Raises
    ------
    GraphError
        If a node ends early or nothing moves any more.
    """
    with EndRequest() as end, running_ros([], domain):
        monitor, executor = Monitor(), SingleThreadedExecutor()
        executor.add_node(monitor)
        shown, moved = _Progress(), time.monotonic()
        while not monitor.ended:
            executor.spin_once(timeout_sec=0.1)
            if end.came:
                raise KeyboardInterrupt
            for node in nodes:
                if node.exit_code is not None:
                    raise GraphError(_obituary(node))
            if shown.show(monitor.state):
                moved = time.monotonic()
            elif time.monotonic() - moved > PATIENCE:
                logs = '\n'.join(f'{n.name}: {n.last_lines(2)}' for n in nodes)
                raise GraphError(f'no progress for {PATIENCE:.0f} s\n{logs}')
        shown.end()
        return monitor.result


def _obituary(node: NodeProcess) -> str:
    return f'{node.name} ended with code {node.exit_code}; {node.log}:\n{node.last_lines()}'


class _Progress:
    """A line per state: overwritten on a terminal, repeated now and then elsewhere."""

    def __init__(self) -> None:
        self._seen = (-1, -1, -1.0)
        self._at = 0.0
        self._live = sys.stdout.isatty()

    def show(self, state: CalibratorState | None) -> bool:
        """Show a state; True if it differs from the one before."""
        if state is None or self._seen == (state.state, state.samples, state.progress):
            return False
        changed = state.state != self._seen[0]
        self._seen = (state.state, state.samples, state.progress)
        now = time.monotonic()
        if self._live or changed or now - self._at > LINE_PERIOD:
            self._at = now
            bar = '#' * round(20 * state.progress)
            text = f'{state.name:<16} [{bar:<20}] {state.samples:>7} samples, '
            text += f'{state.travelled:6.1f} of {state.path_length:.1f} m driven'
            sys.stdout.write(f'\r{text}\033[K' if self._live else f'{text}\n')
            sys.stdout.flush()
        return True

    def end(self) -> None:
        """Leave the line."""
        sys.stdout.write('\n\n' if self._live else '\n')

# SPDX-License-Identifier: Apache-2.0
"""Follows a run from outside: shows its progress, ends with result and, if wanted, diagnosis."""

from __future__ import annotations

import sys
import time

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from otf_bringup.processes import NodeProcess
from otf_core.errors import OtfError
from otf_msgs.msg import CalibrationResult, CalibratorState, GapReport, TrackerStatus
from otf_ros import qos
from otf_ros.app import EndRequest, running_ros
from otf_ros.convert import ns_from_time

PATIENCE = 300.0
"""s; without any progress for so long, something is wrong: on a computer that does other work, a
step of a calibration or of a diagnosis may take minutes. A node that has ended is noticed at once.
"""
LINE_PERIOD = 5.0
"""s between progress lines where they cannot be overwritten."""


class GraphError(OtfError):
    """A node ended too early or nothing moves; the message has the end of its log."""


class Monitor(Node):
    """Listens to state, result and, if wanted, diagnosis of the calibrator, and to the driver."""

    def __init__(self, diagnose: bool) -> None:
        super().__init__('demo_monitor')
        self._diagnose = diagnose
        self.state: CalibratorState | None = None
        self.result: CalibrationResult | None = None
        self.gap: GapReport | None = None
        self.stream = TrackerStatus()
        self.create_subscription(TrackerStatus, 'tracker/status', self._on_stream, qos.STATUS)
        self.create_subscription(CalibratorState, 'calibrator/state', self._on_state, qos.STATUS)
        self.create_subscription(
            CalibrationResult, 'calibrator/result', self._on_result, qos.RESULT
        )
        self.create_subscription(GapReport, 'calibrator/gap_report', self._on_gap, qos.RESULT)

    @property
    def ended(self) -> bool:
        """True once state and result both say how it ended, and the diagnosis if it is wanted."""
        if self.state is None or self.result is None:
            return False
        if self._diagnose and self.result.run_id and self.gap is None:
            return False
        return self.state.state in (CalibratorState.DONE, CalibratorState.FAILED)

    def _on_state(self, message: CalibratorState) -> None:
        self.state = message

    def _on_stream(self, message: TrackerStatus) -> None:
        self.stream = message

    def _on_result(self, message: CalibrationResult) -> None:
        self.result = message

    def _on_gap(self, message: GapReport) -> None:
        self.gap = message


def monitor_run(
    domain: int, nodes: list[NodeProcess], diagnose: bool
) -> tuple[CalibrationResult, TrackerStatus, GapReport | None]:
    """Show progress until there is a result; return it, the stream's end, and the diagnosis.

    Parameters
    ----------
    domain : int
        ROS domain of the nodes.
    nodes : list of NodeProcess
        Watched: the end of one of them ends this.
    diagnose : bool
        Wait for the diagnosis of the run.

    Raises
    ------
    GraphError
        If a node ends early or nothing moves any more.
    """
    with EndRequest() as end, running_ros([], domain):
        monitor, executor = Monitor(diagnose), SingleThreadedExecutor()
        executor.add_node(monitor)
        shown, moved = _Progress(), time.monotonic()
        while not monitor.ended:
            executor.spin_once(timeout_sec=0.1)
            if end.came:
                raise KeyboardInterrupt
            for node in nodes:
                if node.exit_code is not None:
                    raise GraphError(_obituary(node))
            if shown.show(monitor.state, monitor.stream.real_time_factor):
                moved = time.monotonic()
            elif time.monotonic() - moved > PATIENCE:
                logs = '\n'.join(f'{n.name}: {n.last_lines(2)}' for n in nodes)
                raise GraphError(f'no progress for {PATIENCE:.0f} s\n{logs}')
        shown.end()
        assert monitor.result is not None, 'as it has ended'
        return monitor.result, monitor.stream, monitor.gap


def _obituary(node: NodeProcess) -> str:
    return f'{node.name} ended with code {node.exit_code}; {node.log}:\n{node.last_lines()}'


class _Progress:
    """A line per state: overwritten on a terminal, repeated now and then elsewhere."""

    def __init__(self) -> None:
        self._seen: tuple[object, ...] = ()
        self._at = 0.0
        self._live = sys.stdout.isatty()

    def show(self, state: CalibratorState | None, factor: float) -> bool:
        """Show a state and the multiple of real time; True if there is progress since the last.

        Every sample that the calibrator has taken is progress.
        """
        if state is None:
            return False
        name, progress = state.name, state.progress
        if state.diagnosing:
            name, progress = 'DIAGNOSING', state.diagnosis_progress
        seen = (name, ns_from_time(state.taken), progress)
        if seen == self._seen:
            return False
        changed, self._seen = seen[:1] != self._seen[:1], seen
        now = time.monotonic()
        if self._live or changed or now - self._at > LINE_PERIOD:
            self._at = now
            bar = '#' * round(20 * progress)
            text = f'{name:<16} [{bar:<20}] {state.samples:>7} samples, '
            text += f'{state.travelled:6.1f} of {state.path_length:.1f} m driven'
            if state.state == CalibratorState.BUFFERING and factor:
                text += f', {factor:.1f} times as fast as measured'
            if state.time_left > 0.5:  # not so if it is not known: NaN
                text += f', about {state.time_left:.0f} s left'
            sys.stdout.write(f'\r{text}\033[K' if self._live else f'{text}\n')
            sys.stdout.flush()
        return True

    def end(self) -> None:
        """Leave the line."""
        sys.stdout.write('\n\n' if self._live else '\n')

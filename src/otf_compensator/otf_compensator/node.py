# SPDX-License-Identifier: Apache-2.0
"""Compensator node: answers positions with their error, its uncertainty and what to command."""

from __future__ import annotations

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from otf_compensator.answers import CompensationServer
from otf_compensator.params import CompensatorConfig
from otf_compensator.tables import Tables
from otf_core.errors import InputError, OtfError
from otf_msgs.msg import ErrorTables
from otf_ros import qos, services
from otf_ros.diagnostics import PERIOD as DIAGNOSED_EVERY
from otf_ros.diagnostics import Diagnostics, Finding, Level, memory
from otf_ros.lifecycle import SteadyLifecycleNode
from otf_ros.params import NodeParameters

WHEN = 'counts at the next compensator/reload or configure'
INACTIVE = 'the compensator is not active; configure and activate it'
SUCCESS = TransitionCallbackReturn.SUCCESS


class Compensator(SteadyLifecycleNode):
    """Service ``compensator/compensate``: positions in, what to command out.

    configure = read the tables, activate = answer, deactivate = answer no more, cleanup = forget.

    Raises
    ------
    OtfError
        If the tables cannot be read at start and ``auto_start`` is set. Later
        ``compensator/reload`` says so, and the tables that were read last stay.
    """

    def __init__(self) -> None:
        super().__init__('compensator')
        self._settings = NodeParameters(self, CompensatorConfig, read_only=['auto_start'])
        self._settings.tell_when(lambda names: WHEN if 'tables_file' in names else '')
        self._tables: Tables | None = None
        self._active = False
        self._answered_before = 0
        self._error: OtfError | None = None
        self._published: ErrorTables | None = None
        topic = 'calibrator/error_tables'
        self.create_subscription(ErrorTables, topic, self._on_calibrated, qos.RESULT)
        self._answers = CompensationServer(self, self._in_use)
        services.offer(self, 'compensator/reload', self._reload)
        Diagnostics(self, self._machine, {'tables': self._look_at_tables, 'memory': memory})
        if self._settings.read(CompensatorConfig).auto_start:
            self.trigger_configure()
            if self._error:
                raise self._error
            self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the tables that the parameters name."""
        try:
            self._tables = self._read()
        except OtfError as error:
            self._error = error
            self.get_logger().error(f'{error}; correct it and configure again')
            return TransitionCallbackReturn.FAILURE
        self._error = None
        self.get_logger().info(self._tables.words)
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Answer from now on."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Answer no more."""
        self._active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the tables; the next configure reads the parameters anew."""
        self._tables = None
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End for good."""
        self._tables, self._active = None, False
        return SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything after a transition that failed unexpectedly."""
        return self.on_shutdown(state)

    def _machine(self) -> str:
        return self._tables.machine if self._tables else ''

    def _look_at_tables(self) -> Finding:
        """Which tables are in use, and how much they are asked."""
        rate = (self._answers.count - self._answered_before) / DIAGNOSED_EVERY
        self._answered_before = self._answers.count
        values = {'state': self.lifecycle_state, 'answers [1/s]': rate}
        if self._tables is None or not self._active:
            return Finding(Level.WARN, f'requests are not answered: {INACTIVE}', values)
        return Finding(Level.OK, self._tables.words + self._another(self._tables), values)

    def _on_calibrated(self, message: ErrorTables) -> None:
        """Record a calibration; its tables are used only once somebody has them read."""
        self._published = message
        if self._tables and (words := self._another(self._tables)):
            self.get_logger().info(words.removeprefix('; '))

    def _another(self, tables: Tables) -> str:
        """State that another calibration of the same machine is published; else ''."""
        other = self._published
        if not other or other.machine != tables.machine or other.run_id == tables.run_id:
            return ''
        verdict = '' if other.passed else ', which fails a quality gate,'
        return (
            f'; run {other.run_id} of {other.machine}{verdict} is published and not in use: '
            f'compensator/reload reads tables_file again'
        )

    def _read(self) -> Tables:
        return Tables(self._settings.read(CompensatorConfig).tables_file)

    def _reload(self) -> tuple[bool, str]:
        if self._tables is None:
            return False, 'not configured; configure reads the tables'
        try:
            self._tables = self._read()
        except OtfError as error:
            return False, f'{error}; the previous tables stay in use'
        return True, self._tables.words

    def _in_use(self) -> Tables:
        """Return the tables; InputError if the node is not active."""
        if self._tables is None or not self._active:
            raise InputError(INACTIVE)
        return self._tables

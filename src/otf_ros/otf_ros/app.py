# SPDX-License-Identifier: Apache-2.0
"""Start and end of a node process: one clear message and the exit code instead of a traceback."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rclpy
from rclpy.exceptions import InvalidHandle, NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from otf_core.errors import ConfigError, OtfError

WRONG_USAGE = 2
"""Exit code for wrong parameters, as of the command line."""
_USAGE_ERRORS = (
    ParameterException,
    NameValidationException,
    rclpy_implementation.UnknownROSArgsError,
)


@contextmanager
def running_ros(args: list[str] | None) -> Iterator[None]:
    """Context of rclpy: initialised inside, shut down after.

    SIGINT and SIGTERM both shut it down, which ends the executor; KeyboardInterrupt would come in
    the middle of whatever is under way, and rclpy cannot bear that in the middle of a message.
    """
    signal.signal(signal.SIGINT, lambda number, frame: None)
    try:
        rclpy.init(args=args)
    except rclpy_implementation.RCLError as error:
        raise ConfigError(str(error).split(', at /')[0]) from None
    try:
        yield
    finally:
        rclpy.try_shutdown()


def spin(factory: Callable[[], Node], args: list[str] | None = None) -> None:
    """Create one node and serve its callbacks until the process is asked to end.

    A method ``close`` of the node, if it has one, is called at the end; the context may be shut
    down by then.
    """
    with running_ros(args):
        try:
            node = factory()
            try:
                executor = SingleThreadedExecutor()
                executor.add_node(node)
                executor.spin()
            finally:
                if hasattr(node, 'close'):
                    node.close()
                executor.shutdown()
                node.destroy_node()
        except (rclpy_implementation.RCLError, InvalidHandle):
            if rclpy.ok():
                raise  # else: something was under way while the context was shut down


def run(factory: Callable[[], Node], args: list[str] | None = None) -> int:
    """Run a node as a process.

    Parameters
    ----------
    factory : callable
        Makes the node; an OtfError there or later ends the process with its exit code.
    args : list of str, optional
        Command line, ROS arguments included.

    Returns
    -------
    int
        Exit code: 0 after SIGINT or SIGTERM, 2 for wrong parameters, 3 for unusable input.
    """
    try:
        spin(factory, args)
    except ExternalShutdownException:
        return 0
    except OtfError as error:
        return _complain(str(error), error.exit_code)
    except _USAGE_ERRORS as error:
        return _complain(str(error), WRONG_USAGE)
    return 0


def _complain(message: str, code: int) -> int:
    sys.stderr.write(f'error: {message}\n')
    return code

# SPDX-License-Identifier: Apache-2.0
"""Start and end of a node process: one clear message and the exit code instead of a traceback.

rclpy's own signal handlers invalidate the context at any point of the program and, now and then,
leave the executor waiting for ever. Here a signal only leaves a note that is read between two
callbacks, so everything is still valid while the node ends.
"""

from __future__ import annotations

import faulthandler
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from otf_core.errors import ConfigError, OtfError

WRONG_USAGE = 2
"""Exit code for wrong parameters, as of the command line."""
LONGEST_WAIT = 0.2
"""s; how long a signal may have to wait until it is noticed."""
STDERR = 2
"""By its number: a process may run without ``sys.stderr``."""
LONGEST_END = 10.0
"""s; a process that the middleware still holds then ends itself and states where it hangs."""
_USAGE_ERRORS = (
    ParameterException,
    NameValidationException,
    rclpy_implementation.UnknownROSArgsError,
)


class EndRequest:
    """Notes SIGINT and SIGTERM as long as the context lasts."""

    def __init__(self) -> None:
        self.came = False

    def __enter__(self) -> EndRequest:
        global _request
        _request = self
        numbers = (signal.SIGINT, signal.SIGTERM)
        self._before = {number: signal.signal(number, self._note) for number in numbers}
        return self

    def __exit__(self, *error: object) -> None:
        global _request
        _request = None
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: object) -> None:
        self.came = True


_request: EndRequest | None = None


def is_ending() -> bool:
    """Return whether the process is asked to end, for callbacks that take long."""
    return _request is not None and _request.came


@contextmanager
def running_ros(args: list[str] | None = None, domain: int | None = None) -> Iterator[None]:
    """Context of rclpy without signal handlers: initialised inside, shut down after.

    Raises
    ------
    ConfigError
        If the ROS arguments are wrong.
    """
    no_handlers = SignalHandlerOptions.NO
    try:
        rclpy.init(args=args, domain_id=domain, signal_handler_options=no_handlers)
    except rclpy_implementation.RCLError as error:
        raise ConfigError(str(error).split(', at /')[0]) from None
    try:
        yield
    finally:
        rclpy.shutdown()


def spin(factory: Callable[[], Node], args: list[str] | None = None) -> None:
    """Create one node and serve its callbacks until the process is asked to end.

    A method ``close`` of the node, if it has one, is called at the end.
    """
    with EndRequest() as end, running_ros(args):
        try:
            node = factory()
        except OtfError:
            if end.came:  # that is why
                return
            raise
        except rclpy_implementation.RCLError as error:  # such as of security
            raise ConfigError(str(error).split(', at /')[0]) from None
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        try:
            while not end.came:
                executor.spin_once(timeout_sec=LONGEST_WAIT)
        finally:
            if hasattr(node, 'close'):
                node.close()
            faulthandler.dump_traceback_later(LONGEST_END, exit=True, file=STDERR)
            executor.shutdown()
            node.destroy_node()


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
        Exit code: 0 after SIGINT or SIGTERM, 2 for wrong parameters, 3 for unusable input. A
        process that hangs at its end leaves with 1.
    """
    try:
        spin(factory, args)
    except OtfError as error:
        return _complain(str(error), error.exit_code)
    except _USAGE_ERRORS as error:
        return _complain(str(error), WRONG_USAGE)
    finally:
        faulthandler.cancel_dump_traceback_later()
    return 0


def _complain(message: str, code: int) -> int:
    sys.stderr.write(f'error: {message}\n')
    return code

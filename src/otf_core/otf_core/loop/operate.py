# SPDX-License-Identifier: Apache-2.0
"""Operator of LinuxCNC without a screen: homes, drives the named programs, samples, ends.

Runs under the Python of the system, where the module ``linuxcnc`` is; started by LinuxCNC as its
display. ``order.json``: programs and their time limits; ``told.json``: what happened.
"""

import json
import subprocess
import time
from collections.abc import Callable
from typing import Any

import linuxcnc  # type: ignore[import-not-found]

POLL_PERIOD = 0.02
"""s between two looks at the control."""


class ControlError(Exception):
    """The control did not do what was asked."""


def wait_until(stat: Any, reached: Callable[[Any], bool], seconds: float, what: str) -> None:
    """Wait until the control tells something."""
    end = time.monotonic() + seconds
    while True:
        stat.poll()
        if reached(stat):
            return
        if time.monotonic() > end:
            raise ControlError(f'{what} not within {seconds:.0f} s')
        time.sleep(POLL_PERIOD)


def switch_on(command: Any, stat: Any) -> None:
    """Release the stop, switch on, home all joints."""
    command.state(linuxcnc.STATE_ESTOP_RESET)
    command.wait_complete()
    command.state(linuxcnc.STATE_ON)
    command.wait_complete()
    wait_until(stat, lambda s: s.task_state == linuxcnc.STATE_ON, 10, 'machine on')
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    for joint in range(stat.joints):
        command.home(joint)
    wait_until(stat, lambda s: all(s.homed[: s.joints]), 20, 'homing')


def drive_program(
    command: Any, stat: Any, errors: Any, name: str, samples: str, seconds: float
) -> None:
    """Drive one program and sample every servo period."""
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete()
    command.program_open(name)
    command.wait_complete()
    sampler = subprocess.Popen(['halsampler', '-t', samples], stdin=subprocess.DEVNULL)
    try:
        time.sleep(0.3)
        command.auto(linuxcnc.AUTO_RUN, 0)
        wait_until(stat, lambda s: s.interp_state != linuxcnc.INTERP_IDLE, 10, f'{name}: start')
        end = time.monotonic() + seconds
        while stat.interp_state != linuxcnc.INTERP_IDLE:
            message = errors.poll()
            if message:
                raise ControlError(f'{name}: {message[1]}')
            if stat.interp_state == linuxcnc.INTERP_PAUSED:
                command.auto(linuxcnc.AUTO_RESUME)  # the program waits for the recording
            if time.monotonic() > end:
                raise ControlError(f'{name}: not done within {seconds:.0f} s')
            time.sleep(POLL_PERIOD)
            stat.poll()
        time.sleep(0.3)
    finally:
        sampler.terminate()
        sampler.wait()


def main() -> None:
    """Do what order.json asks; tell it in told.json."""
    with open('order.json', encoding='utf-8') as file:
        order = json.load(file)
    report: dict[str, Any] = {'done': [], 'error': None}
    command, stat, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
    try:
        switch_on(command, stat)
        for item in order:
            drive_program(command, stat, errors, item['program'], item['samples'], item['seconds'])
            report['done'].append(item['program'])
    except (ControlError, linuxcnc.error) as error:
        report['error'] = str(error)
    with open('told.json', 'w', encoding='utf-8') as file:
        json.dump(report, file)


if __name__ == '__main__':
    main()

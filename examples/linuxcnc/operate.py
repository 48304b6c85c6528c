#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Operator of LinuxCNC without a screen: homes, drives every program of the folder, records it.

LinuxCNC starts this file as its display, with the Python of the system, which has its module
``linuxcnc``. A program NAME.ngc pauses (M0) where its recording is to begin: NAME.txt then holds
every servo period up to its end. ``outcome.txt`` says 'done', or what went wrong.
"""

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import linuxcnc  # type: ignore[import-not-found]

command, stat, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


class ControlError(Exception):
    """The control did not do what was asked."""


def wait_until(reached: Callable[[], bool], seconds: float, what: str) -> None:
    """Wait until the control is in a state; a message of its own ends the wait."""
    end = time.monotonic() + seconds
    stat.poll()
    while not reached():
        message = errors.poll()
        if message:
            raise ControlError(f'{what}: {message[1]}')
        if time.monotonic() > end:
            raise ControlError(f'{what}: not within {seconds:.0f} s')
        time.sleep(0.02)
        stat.poll()


def switch_on() -> None:
    """Release the stop, switch on, home all joints."""
    for state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON):
        command.state(state)
        command.wait_complete()
    wait_until(lambda: stat.task_state == linuxcnc.STATE_ON, 20, 'switching on')
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    for joint in range(stat.joints):
        command.home(joint)
    wait_until(lambda: all(stat.homed[: stat.joints]), 20, 'homing')


def record(on: bool) -> None:
    """Switch the sampler on or off."""
    subprocess.run(['halcmd', 'setp', 'sampler.0.enable', str(int(on))], check=True)


def drive(program: Path) -> None:
    """Drive a program, and record it from its pause on."""
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete()
    command.program_open(program.name)
    command.wait_complete()
    samples = program.with_suffix('.txt')
    sampler = subprocess.Popen(['halsampler', '-t', samples], stdin=subprocess.DEVNULL)
    try:
        command.auto(linuxcnc.AUTO_RUN, 0)
        paused, idle = linuxcnc.INTERP_PAUSED, linuxcnc.INTERP_IDLE
        wait_until(lambda: stat.interp_state == paused and stat.inpos, 60, f'{program}: approach')
        record(True)
        command.auto(linuxcnc.AUTO_RESUME)
        wait_until(lambda: stat.interp_state == idle, 3600, str(program))
        record(False)
        time.sleep(0.5)  # the last samples are on their way
    finally:
        sampler.terminate()
        sampler.wait()


def main() -> None:
    """Drive all programs and say how that went."""
    outcome = 'done'
    try:
        switch_on()
        for program in sorted(Path().glob('*.ngc')):
            drive(program)
    except (ControlError, linuxcnc.error, subprocess.CalledProcessError) as error:
        outcome = str(error)
    Path('outcome.txt').write_text(outcome, encoding='utf-8')


if __name__ == '__main__':
    main()

# SPDX-License-Identifier: Apache-2.0
"""Configuration of LinuxCNC for a machine without a screen: INI, HAL, tool table.

Source: LinuxCNC 2.9, ``docs/src/config/ini-config.adoc``, ``docs/src/man/man9/motion.9``,
``sampler.9`` and ``docs/src/motion/external-offsets.adoc``. Lengths are in mm there.

The motors follow their commands at once: ``motor-pos-cmd`` is fed back and sampled every servo
period, with what the control believes (``pos-cmd``) and the external offsets in it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from otf_core.model.frames import XYZ
from otf_core.model.machine import Machine

SERVO_PERIOD = 1e-3
"""s"""
SAMPLER_DEPTH = 20_000
"""Rows that wait for the reader; 20 s."""
MARGIN = 0.01
"""m; soft limits lie this far beyond the axis ranges, and hold the home position 0."""
OFFSET_SHARE = 0.1
"""Share of speed and acceleration that external offsets may take (OFFSET_AV_RATIO)."""
COUNT = 1e-8
"""m; one count of an external offset."""
INI, HAL, OPERATOR, VOLUME = 'otf.ini', 'otf.hal', 'operate.py', 'offsets.py'
LATTICE, SAMPLES = 'lattice.csv', 'samples.txt'


def ini_text(machine: Machine, acceleration: float, feed: float) -> str:
    """INI file of a machine with trivial kinematics.

    Parameters
    ----------
    machine : Machine
    acceleration : float
        m/s^2, of every axis.
    feed : float
        m/s, largest of the programs.
    """
    speed, rate = 1e3 * 2.0 * feed, 1e3 * acceleration
    lines = [
        '[EMC]', 'VERSION = 1.1', 'MACHINE = otf', 'DEBUG = 0',
        '[DISPLAY]', f'DISPLAY = ./{OPERATOR}',
        '[TASK]', 'TASK = milltask', 'CYCLE_TIME = 0.005',
        '[RS274NGC]', 'PARAMETER_FILE = sim.var',
        '[EMCMOT]', 'EMCMOT = motmod', 'COMM_TIMEOUT = 1.0',
        f'SERVO_PERIOD = {1e9 * SERVO_PERIOD:.0f}',
        '[EMCIO]', 'EMCIO = io', 'CYCLE_TIME = 0.1', 'TOOL_TABLE = tool.tbl',
        '[HAL]', f'HALFILE = {HAL}',
        '[TRAJ]', 'COORDINATES = X Y Z', 'LINEAR_UNITS = mm', 'ANGULAR_UNITS = degree',
        f'DEFAULT_LINEAR_VELOCITY = {speed:.3f}', f'MAX_LINEAR_VELOCITY = {speed:.3f}',
        f'DEFAULT_LINEAR_ACCELERATION = {rate:.3f}', f'MAX_LINEAR_ACCELERATION = {rate:.3f}',
        '[KINS]', 'KINEMATICS = trivkins coordinates=xyz', 'JOINTS = 3',
    ]  # fmt: skip
    for k, axis in enumerate(machine.axis_names):
        low = 1e3 * (min(float(machine.lower[k]), 0.0) - MARGIN)
        high = 1e3 * (max(float(machine.upper[k]), 0.0) + MARGIN)
        limits = [
            f'MIN_LIMIT = {low:.3f}', f'MAX_LIMIT = {high:.3f}',
            f'MAX_VELOCITY = {speed / (1 - OFFSET_SHARE):.3f}',
            f'MAX_ACCELERATION = {rate / (1 - OFFSET_SHARE):.3f}',
        ]  # fmt: skip
        lines += [f'[AXIS_{axis}]', *limits, f'OFFSET_AV_RATIO = {OFFSET_SHARE}']
        lines += [
            f'[JOINT_{k}]', 'TYPE = LINEAR', *limits, 'HOME = 0', 'HOME_OFFSET = 0',
            'HOME_SEARCH_VEL = 0', 'HOME_LATCH_VEL = 0', 'HOME_SEQUENCE = 0',
            'FERROR = 1000', 'MIN_FERROR = 1000',
        ]  # fmt: skip
    return '\n'.join(lines) + '\n'


def with_piece(ini: str, piece: str) -> str:
    """Put the lines of an INI piece into its sections: a section that comes twice counts once."""
    lines, at = ini.splitlines(), 0
    for line in piece.splitlines():
        if line.startswith('['):
            at = lines.index(line) + 1
        elif line and not line.startswith('#'):
            lines.insert(at, line)
    return '\n'.join(lines) + '\n'


def hal_text(volume: bool) -> str:
    """HAL file: motors that follow at once, the sampler, and the component of the volume."""
    lines = [
        'loadrt [KINS]KINEMATICS',
        'loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS',
        f'loadrt sampler depth={SAMPLER_DEPTH} cfg=fffffffff',
        'addf motion-command-handler servo-thread',
        'addf motion-controller servo-thread',
        'addf sampler.0 servo-thread',
        'net enable iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in',
        'net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared',
        'net change iocontrol.0.tool-change => iocontrol.0.tool-changed',
    ]
    if volume:
        lines.append(f'loadusr -Wn otf-volume /usr/bin/python3 ./{VOLUME} {LATTICE}')
        lines.append('net fault otf-volume.fault => motion.feed-hold')
    for k, axis in enumerate(XYZ):
        letter = axis.lower()
        ends = (f' otf-volume.believed-{letter}', f' otf-volume.offset-{letter}')
        believed, offset = ends if volume else ('', '')
        lines += [
            f'net motor{k} joint.{k}.motor-pos-cmd => joint.{k}.motor-pos-fb sampler.0.pin.{k}',
            f'net believed{k} joint.{k}.pos-cmd => sampler.0.pin.{3 + k}{believed}',
            f'net offset{k} axis.{letter}.eoffset => sampler.0.pin.{6 + k}{offset}',
        ]
        if volume:
            lines += [
                f'setp axis.{letter}.eoffset-scale {1e3 * COUNT:.9f}',
                f'net wanted{k} otf-volume.counts-{letter} => axis.{letter}.eoffset-counts',
                f'net on{k} otf-volume.on-{letter} => axis.{letter}.eoffset-enable',
            ]
    return '\n'.join(lines) + '\n'


def believed_positions(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Take sampled rows apart.

    Parameters
    ----------
    samples : ndarray, shape (n, 9), mm
        Motor positions, commanded positions, external offsets.

    Returns
    -------
    motor, believed, offset : ndarray, shape (n, 3), m
        Where the motors are, where the control believes the target to be, offset in the motors.
    """
    metres = 1e-3 * samples
    motor, commanded, offset = metres[:, :3], metres[:, 3:6], metres[:, 6:9]
    return motor, commanded - offset, offset


def written_files(
    ini: str, programs: Mapping[str, str], extra: Mapping[str, bytes], volume: bool
) -> dict[str, bytes]:
    """All files of a run of the control but the scripts, by name."""
    texts = {INI: ini, HAL: hal_text(volume), 'tool.tbl': '', **programs}
    return {name: text.encode() for name, text in texts.items()} | dict(extra)

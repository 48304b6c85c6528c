# SPDX-License-Identifier: Apache-2.0
"""The whole circle on LinuxCNC: drive, measure, calibrate, compensate, drive other lines.

ros2 launch otf_bringup loop.launch.py                    the machine of config/machine.yaml
ros2 launch otf_bringup loop.launch.py machine_file:=MACHINE.yaml compensate:=axes seed:=3

It is the command otf loop (docs/loop.md), which also says how to get LinuxCNC where it is not.
"""

import sys
from contextlib import suppress
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction

from launch import LaunchDescription
from otf_bringup.launching import is_on, refuse_unknown, shut_down_on_exit
from otf_core.cli.options import CLI_UNITS
from otf_core.config import LoopConfig

CONFIG = Path(get_package_share_directory('otf_bringup')) / 'config'
ARGUMENTS = [
    ('machine_file', str(CONFIG / 'machine.yaml'), 'machine description'),
    ('out', 'loop', 'folder for loop.json, calibration, bags and what the control was given'),
    ('compensate', '', 'axes, volume (default) or program; pivot for a trunnion'),
    ('overwrite', 'false', 'replace existing results'),
]
INFOS = tuple(LoopConfig.infos())
FILES = ('loop.launch.py',)


def generate_launch_description():
    own = [
        (i.name, '', f'{i.meaning} ({i.unit or "number"}; default {i.default:g})') for i in INFOS
    ]
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, default, text in (*ARGUMENTS, *own)
    ]
    known = [argument.name for argument in declared]
    return LaunchDescription([*declared, OpaqueFunction(function=loop, args=[known])])


def option(info, text):
    """Return a parameter as the command takes it; what is not a number the command refuses."""
    if not text:
        return []
    factor = CLI_UNITS.get(info.name, ('', 1))[1]
    with suppress(ValueError):
        text = repr(float(text) * factor) if factor != 1 else text
    return [f'--{info.name.replace("_", "-")}', text]


def loop(context, known):
    """Return the process of the command."""
    given = context.launch_configurations
    refuse_unknown(known, context.argv, FILES)
    words = ['--machine', given['machine_file'], '--out', given['out']]
    words += ['--compensate', given['compensate']] if given['compensate'] else []
    words += [word for info in INFOS for word in option(info, given[info.name])]
    if is_on(given, 'overwrite'):
        words.append('--overwrite')
    return [
        ExecuteProcess(
            cmd=[sys.executable, '-m', 'otf_core.cli', 'loop', *words],
            name='loop',
            output='screen',
            on_exit=shut_down_on_exit,
        )
    ]

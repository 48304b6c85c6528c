# SPDX-License-Identifier: Apache-2.0
"""The compensator alone, beside a robot or a control that asks it.

ros2 launch otf_bringup compensator.launch.py tables_file:=calibrations/latest/error_tables.json
ros2 launch otf_bringup compensator.launch.py tables_file:=TABLES.json auto_start:=false
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import LifecycleNode

from launch import LaunchDescription
from otf_bringup.launching import is_on, refuse_unknown, shut_down_on_exit

ARGUMENTS = {
    'tables_file': 'error_tables.json of a calibration',
    'namespace': 'namespace of node and topics',
    'auto_start': 'configure and activate at start; false: wait for lifecycle transitions',
}
DEFAULTS = {'namespace': '', 'auto_start': 'true'}
FILES = ('compensator.launch.py',)


def generate_launch_description():
    return LaunchDescription([
        *(
            DeclareLaunchArgument(name, default_value=DEFAULTS.get(name), description=text)
            for name, text in ARGUMENTS.items()
        ),
        OpaqueFunction(function=compensator),
    ])  # fmt: skip


def compensator(context):
    """Return the node."""
    given = context.launch_configurations
    refuse_unknown(list(ARGUMENTS), context.argv, FILES)
    return [
        LifecycleNode(
            package='otf_compensator',
            executable='compensator',
            name='compensator',
            namespace=given['namespace'],
            parameters=[
                {
                    'tables_file': given['tables_file'],
                    'auto_start': is_on(given, 'auto_start'),
                }
            ],
            ros_arguments=['--enclave', '/otf/compensator'],
            output='screen',
            on_exit=shut_down_on_exit,
        )
    ]

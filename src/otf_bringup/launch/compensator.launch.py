# SPDX-License-Identifier: Apache-2.0
"""The compensator alone, beside a robot or a control that asks it.

ros2 launch otf_bringup compensator.launch.py tables_file:=calibrations/latest/error_tables.json
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description():
    return LaunchDescription([
        DeclareLaunchArgument('tables_file', description='error_tables.json of a calibration'),
        DeclareLaunchArgument('namespace', default_value='', description='of node and topics'),
        Node(
            package='otf_compensator',
            executable='compensator',
            name='compensator',
            namespace=LaunchConfiguration('namespace'),
            parameters=[{'tables_file': LaunchConfiguration('tables_file')}],
            ros_arguments=['--enclave', '/otf/compensator'],
        ),
    ])  # fmt: skip

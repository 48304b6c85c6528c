# SPDX-License-Identifier: Apache-2.0
"""Calibrate a recorded bag with the live nodes.

ros2 launch otf_bringup replay.launch.py bag:=BAG machine_file:=MACHINE.yaml time_scale:=10.0
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

from launch import LaunchDescription


def generate_launch_description():
    cell = Path(get_package_share_directory('otf_bringup')) / 'launch' / 'cell.launch.py'
    return LaunchDescription(
        [
            DeclareLaunchArgument('bag', description='rosbag2 folder or .mcap file'),
            DeclareLaunchArgument('machine_file', description='machine.yaml of that machine'),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(str(cell)),
                launch_arguments={'backend': 'replay'}.items(),
            ),
        ]
    )

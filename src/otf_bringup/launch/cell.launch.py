# SPDX-License-Identifier: Apache-2.0
"""The calibration cell: planner, tracker driver, calibrator.

ros2 launch otf_bringup cell.launch.py                    simulated cell, real time
ros2 launch otf_bringup cell.launch.py time_scale:=10.0   the same, ten times as fast
ros2 launch otf_bringup cell.launch.py diagnose:=true effects:=BACKLASH.yaml
ros2 launch otf_bringup cell.launch.py backend:=replay bag:=BAG machine_file:=MACHINE.yaml
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription


def generate_launch_description():
    config = Path(get_package_share_directory('otf_bringup')) / 'config'
    arguments = [
        ('machine_file', str(config / 'machine.yaml'), 'machine description'),
        ('params_file', str(config / 'params.yaml'), 'all other parameters'),
        ('namespace', '', 'namespace of nodes and topics'),
        ('output_directory', 'calibrations', 'where results go'),
        ('path_file', '', 'CSV with corner points (x,y,z) to drive instead of a created path'),
        ('backend', 'simulated', 'source of the samples: simulated or replay'),
        ('bag', '', 'bag to replay; its path is used, the planner does not run'),
        ('time_scale', '1.0', 'how many times as fast as real time to simulate or replay'),
        ('truth_tables', '', 'error_tables.json of the simulated machine; empty: drawn'),
        ('effects', '', 'effects.yaml: what else is wrong in the simulated cell'),
        ('diagnose', 'false', 'diagnose every run after its calibration'),
    ]

    kinds = {'time_scale': float, 'diagnose': bool}

    def node(name, taken, **options):
        given = {
            key: ParameterValue(LaunchConfiguration(key), value_type=kinds.get(key, str))
            for key in taken
        }
        return Node(
            package=f'otf_{name}',
            executable=name,
            name=name,
            namespace=LaunchConfiguration('namespace'),
            parameters=[LaunchConfiguration('params_file'), given],
            output='screen',
            emulate_tty=True,
            **options,
        )

    driven = ['machine_file', 'backend', 'bag', 'truth_tables', 'effects', 'time_scale']
    simulated = IfCondition(EqualsSubstitution(LaunchConfiguration('backend'), 'simulated'))
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value, description=text)
                for name, value, text in arguments
            ),
            node('path_planner', ['machine_file', 'path_file'], condition=simulated),
            node('calibrator', ['machine_file', 'output_directory', 'diagnose']),
            node('tracker_driver', driven),
        ]
    )

# SPDX-License-Identifier: Apache-2.0
"""The calibration cell: planner, tracker driver, calibrator.

ros2 launch otf_bringup cell.launch.py                    simulated cell, real time
ros2 launch otf_bringup cell.launch.py time_scale:=10.0   the same, ten times as fast
ros2 launch otf_bringup cell.launch.py diagnose:=true effects:=BACKLASH.yaml
ros2 launch otf_bringup cell.launch.py view:=true         the same with a page in the browser
ros2 launch otf_bringup cell.launch.py backend:=replay bag:=BAG machine_file:=MACHINE.yaml
ros2 launch otf_bringup cell.launch.py backend:=emscon emscon.host:=HOST machine_file:=MACHINE.yaml
ros2 launch otf_bringup cell.launch.py backend:=stream stream.source:=SOURCE.yaml machine_file:=...
"""

from contextlib import suppress
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, TextSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from otf_tracker_driver.backends import BACKENDS

CONFIG = Path(get_package_share_directory('otf_bringup')) / 'config'
ARGUMENTS = [
    ('machine_file', str(CONFIG / 'machine.yaml'), 'machine description'),
    ('params_file', str(CONFIG / 'params.yaml'), 'all other parameters'),
    ('namespace', '', 'namespace of nodes and topics'),
    ('output_directory', 'calibrations', 'where results go'),
    ('path_file', '', 'CSV with corner points (x,y,z) to drive instead of a created path'),
    ('backend', 'simulated', f'source of the samples: {" or ".join(BACKENDS)}'),
    ('time_scale', '1.0', 'how many times as fast as measured to simulate or replay'),
    ('diagnose', 'false', 'diagnose every run after its calibration'),
    ('view', 'false', 'show the run: markers, numbers for plots, a page for the browser'),
]
SHORT = {
    'replay.bag': 'bag',
    'simulated.truth_tables': 'truth_tables',
    'simulated.effects': 'effects',
}
"""Parameters of backends whose launch argument leaves out the name of the backend."""
VIEWERS = ('viewer', 'page')
KINDS = {'time_scale': float, 'diagnose': bool}
BACKEND_PARAMETERS = {
    f'{name}.{info.name}': info
    for name, backend in BACKENDS.items()
    for info in backend.parameters.infos()
}


def generate_launch_description():
    own = [
        (SHORT.get(name, name), '', f'{info.meaning} (default: that of params_file)')
        for name, info in BACKEND_PARAMETERS.items()
    ]
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, default, text in (*ARGUMENTS, *own)
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


def nodes(context):
    """Return the nodes; no planner where the path comes with the samples."""
    given = context.launch_configurations
    backend = BACKENDS.get(given['backend'])
    own = {
        name: parameter(given[SHORT.get(name, name)], type(info.default))
        for name, info in BACKEND_PARAMETERS.items()
        if given[SHORT.get(name, name)]
    }
    planner = node('path_planner', given, ['machine_file', 'path_file'])
    return [
        *([] if backend and backend.brings_path else [planner]),
        node('calibrator', given, ['machine_file', 'output_directory', 'diagnose']),
        node('tracker_driver', given, ['machine_file', 'backend', 'time_scale'], own),
        *([node(name, given, []) for name in VIEWERS] if given['view'] == 'true' else []),
    ]


def parameter(text, kind):
    """Return the text of a launch argument as a parameter; what does not fit the node refuses."""
    if kind is float:
        with suppress(ValueError):
            return float(text)  # YAML takes 1e-5 for text
    return ParameterValue(TextSubstitution(text=text), value_type=str if kind is str else None)


def node(name, given, taken, further=None):
    """Return a node that takes parameters from the launch arguments of the same names."""
    parameters = {key: parameter(given[key], KINDS.get(key, str)) for key in taken}
    return Node(
        package='otf_view' if name in VIEWERS else f'otf_{name}',
        executable=name,
        name=name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[LaunchConfiguration('params_file'), {**parameters, **(further or {})}],
        remappings=[('/tf_static', 'tf_static')] if given['namespace'] else [],
        output='screen',
        emulate_tty=True,
    )

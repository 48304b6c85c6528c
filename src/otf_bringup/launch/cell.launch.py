# SPDX-License-Identifier: Apache-2.0
"""The calibration cell: planner, tracker driver, calibrator.

ros2 launch otf_bringup cell.launch.py                    simulated cell, real time
ros2 launch otf_bringup cell.launch.py time_scale:=10.0   the same, ten times as fast
ros2 launch otf_bringup cell.launch.py diagnose:=true simulated.effects:=BACKLASH.yaml
ros2 launch otf_bringup cell.launch.py view:=true         the same with a page in the browser
ros2 launch otf_bringup cell.launch.py backend:=replay bag:=BAG machine_file:=MACHINE.yaml
ros2 launch otf_bringup cell.launch.py backend:=emscon emscon.host:=HOST machine_file:=MACHINE.yaml
ros2 launch otf_bringup cell.launch.py backend:=stream stream.source:=SOURCE.yaml machine_file:=...
ros2 launch otf_bringup cell.launch.py respawn:=true      nodes that die come back; else all end

Every parameter of the three nodes is an argument of its name. Several cells: docs/graph.md
"""

from contextlib import suppress
from functools import partial
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, TextSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from otf_bringup.launching import is_on, refuse_unknown, shut_down_on_exit
from otf_bringup.params_file import infos
from otf_tracker_driver.backends import BACKENDS

CONFIG = Path(get_package_share_directory('otf_bringup')) / 'config'
NODES, VIEWERS = ('path_planner', 'calibrator', 'tracker_driver'), ('viewer', 'page')
OWN = {
    'params_file': (str(CONFIG / 'params.yaml'), 'parameters that no argument gives'),
    'namespace': ('', 'namespace of nodes and topics'),
    'view': ('false', 'show the run: markers, numbers for plots, a page for the browser'),
    'use_sim_time': ('false', 'stamp states and results with the time of /clock'),
    'respawn': ('false', 'restart a node that has died; otherwise the end of one ends all'),
    'nodes': (','.join(NODES), 'which nodes to start'),
    'tracker': ('', 'namespace of the tracker, if not that of the cell'),
    'planner': ('', 'namespace of the path planner, if not that of the cell'),
}
"""Arguments that are no parameters: default and meaning."""
DEFAULTS = {'machine_file': str(CONFIG / 'machine.yaml'), 'backend': 'simulated'}
SHORT = {'replay.bag': 'bag'}
PARAMETERS = {
    node: {SHORT.get(i.name, i.name): i for i in infos(node)} for node in (*NODES, *VIEWERS)
}
"""What each node takes, by the name of the argument."""
FILES = 'cell.launch.py', 'replay.launch.py'
RESPAWN_DELAY = 0.3
"""s"""
AGAIN = '; respawn:=true starts a node again'


def generate_launch_description():
    described = {
        name: (
            DEFAULTS.get(name, ''),
            f'{info.meaning}{f" [{info.unit}]" if info.unit else ""}'
            f'{"" if name in DEFAULTS else " (default: that of params_file)"}',
        )
        for node in NODES
        for name, info in PARAMETERS[node].items()
    }
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in {**described, **OWN}.items()
    ]
    known = [argument.name for argument in declared]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes, args=[known])])


def nodes(context, known):
    """Return the nodes; no planner where the path comes with the samples."""
    given = context.launch_configurations
    refuse_unknown(known, context.argv, FILES)
    wanted = [name.strip() for name in given['nodes'].split(',')]
    for name in wanted:
        if name not in NODES:
            raise RuntimeError(f'nodes: {name!r} is unknown; possible: {", ".join(NODES)}')
    backend = BACKENDS.get(given['backend'])
    if backend and backend.brings_path and 'tracker_driver' in wanted:
        wanted = [name for name in wanted if name != 'path_planner']
    viewers = VIEWERS if is_on(given, 'view') else ()
    return [node(name, given) for name in (*wanted, *viewers)]


def parameters_of(name, given):
    """Return the parameters of a node that are given; what does not fit the node refuses."""
    parameters = {'use_sim_time': is_on(given, 'use_sim_time')}
    for argument, info in PARAMETERS[name].items():
        text, kind = given.get(argument, ''), type(info.default)
        if not text:
            continue
        plain = ParameterValue(
            TextSubstitution(text=text), value_type=str if kind is str else None
        )
        parameters[info.name] = is_on(given, argument) if kind is bool else plain
        if kind is float:
            with suppress(ValueError):
                parameters[info.name] = float(text)  # YAML takes 1e-5 for text
    return parameters


def elsewhere(given):
    """Return remappings of what comes from other namespaces; tf stays within the cell."""
    names = {
        'tracker': ('point', 'status', 'gap', 'calibrated'),
        'planner': ('path', 'axes', 'plan'),
    }
    return [
        *([('/tf_static', 'tf_static')] if given['namespace'] else []),
        *(
            (f'{kind}/{name}', f'/{given[kind].strip("/")}/{kind}/{name}')
            for kind, topics in names.items()
            if given[kind]
            for name in topics
        ),
    ]


def node(name, given):
    """Return a node."""
    respawn = is_on(given, 'respawn')
    return Node(
        package='otf_view' if name in VIEWERS else f'otf_{name}',
        executable=name,
        name=name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[LaunchConfiguration('params_file'), parameters_of(name, given)],
        remappings=elsewhere(given),
        ros_arguments=['--enclave', f'/otf/{name}'],
        output='screen',
        emulate_tty=True,
        respawn=respawn,
        respawn_delay=RESPAWN_DELAY,
        on_exit=None if respawn or name in VIEWERS else partial(shut_down_on_exit, hint=AGAIN),
    )

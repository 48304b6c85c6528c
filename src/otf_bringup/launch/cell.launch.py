# SPDX-License-Identifier: Apache-2.0
"""The calibration cell: planner, tracker driver, calibrator.

ros2 launch otf_bringup cell.launch.py                    simulated cell, real time
ros2 launch otf_bringup cell.launch.py time_scale:=10.0   the same, ten times as fast
ros2 launch otf_bringup cell.launch.py diagnose:=true effects:=BACKLASH.yaml
ros2 launch otf_bringup cell.launch.py view:=true         the same with a page in the browser
ros2 launch otf_bringup cell.launch.py backend:=replay bag:=BAG machine_file:=MACHINE.yaml
ros2 launch otf_bringup cell.launch.py backend:=emscon emscon.host:=HOST machine_file:=MACHINE.yaml
ros2 launch otf_bringup cell.launch.py backend:=stream stream.source:=SOURCE.yaml machine_file:=...
ros2 launch otf_bringup cell.launch.py respawn:=true      nodes that die come back; else all end

Several cells, trackers and machines: docs/graph.md
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
from otf_core.config import PlannerConfig
from otf_tracker_driver.backends import BACKENDS

CONFIG = Path(get_package_share_directory('otf_bringup')) / 'config'
ARGUMENTS = [
    ('machine_file', str(CONFIG / 'machine.yaml'), 'machine description'),
    ('params_file', str(CONFIG / 'params.yaml'), 'all other parameters'),
    ('namespace', '', 'namespace of nodes and topics'),
    ('output_directory', 'calibrations', 'where results go'),
    (
        'path_file',
        '',
        'path to drive instead of a created one: CSV x,y,z, plan.json or NC program; with rotary '
        'axes CSV target,x,y,z,a,c',
    ),
    ('backend', 'simulated', f'source of the samples: {" or ".join(BACKENDS)}'),
    ('time_scale', '1.0', 'how many times as fast as measured to simulate or replay'),
    ('diagnose', 'false', 'diagnose every run after its calibration'),
    ('view', 'false', 'show the run: markers, numbers for plots, a page for the browser'),
    ('use_sim_time', 'false', 'stamp states and results with the time of /clock'),
    ('machine_frame', 'machine', 'frame_id of path, tables and positions'),
    ('tracker_frame', 'tracker', 'frame_id of the samples'),
    ('respawn', 'false', 'restart a node that has died; otherwise the end of one node ends all'),
    ('nodes', 'path_planner,calibrator,tracker_driver', 'which nodes to start'),
    ('tracker', '', 'namespace of the tracker, if not that of the cell'),
    ('planner', '', 'namespace of the path planner, if not that of the cell'),
    ('rate', '', 'samples per second, simulated or of an emScon tracker'),
]
FILES = 'cell.launch.py', 'replay.launch.py'
RESPAWN_DELAY = 0.3
"""s"""
AGAIN = '; respawn:=true starts a node again'
SHORT = {
    'replay.bag': 'bag',
    'simulated.truth_tables': 'truth_tables',
    'simulated.effects': 'effects',
    'simulated.seed': 'seed',
}
"""Parameters of backends whose launch argument leaves out the name of the backend."""
VIEWERS = ('viewer', 'page')
KINDS = {'time_scale': float, 'diagnose': bool, 'use_sim_time': bool}
PLANNER_PARAMETERS = {info.name: info for info in PlannerConfig.infos()}
BACKEND_PARAMETERS = {
    f'{name}.{info.name}': info
    for name, backend in BACKENDS.items()
    for info in backend.parameters.infos()
    if f'{name}.{info.name}' not in ('simulated.rate', 'emscon.interval')
}
INFOS = {**PLANNER_PARAMETERS, **BACKEND_PARAMETERS}


def unit_of(info):
    """Return the unit of a parameter as descriptions have it: ' [m/s]', or nothing."""
    return f' [{info.unit}]' if info.unit else ''


def generate_launch_description():
    own = [
        (
            SHORT.get(name, name),
            '',
            f'{info.meaning}{unit_of(info)} (default: that of params_file)',
        )
        for name, info in INFOS.items()
    ]
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, default, text in (*ARGUMENTS, *own)
    ]
    known = [argument.name for argument in declared]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes, args=[known])])


def nodes(context, known):
    """Return the nodes; no planner where the path comes with the samples."""
    given = context.launch_configurations
    refuse_unknown([*known, 'bag'], context.argv, FILES)
    backend = BACKENDS.get(given['backend'])
    parameters_of = {
        'path_planner': (['machine_file', 'path_file'], further(given, PLANNER_PARAMETERS)),
        'calibrator': (['machine_file', 'output_directory', 'diagnose'], {}),
        'tracker_driver': (
            ['machine_file', 'backend', 'time_scale'],
            {**further(given, BACKEND_PARAMETERS), **rate(given)},
        ),
    }
    wanted = [name.strip() for name in given['nodes'].split(',')]
    for name in wanted:
        if name not in parameters_of:
            raise RuntimeError(f'nodes: {name!r} is unknown; possible: {", ".join(parameters_of)}')
    if backend and backend.brings_path and 'tracker_driver' in wanted:
        del parameters_of['path_planner']
    viewers = VIEWERS if is_on(given, 'view') else ()
    return [
        *(node(name, given, *parameters_of[name]) for name in parameters_of if name in wanted),
        *(node(name, given, [], {}) for name in viewers),
    ]


def further(given, infos):
    """Return the parameters that have been given, by their names in the node."""
    words = {name: given[SHORT.get(name, name)] for name in infos}
    return {
        name: parameter(text, type(infos[name].default)) for name, text in words.items() if text
    }


def rate(given):
    """Return the parameters of the backends that say how many samples come per second."""
    if not given['rate']:
        return {}
    try:
        hertz = float(given['rate'])
        return {'simulated.rate': hertz, 'emscon.interval': 1 / hertz}
    except (ValueError, ZeroDivisionError):
        raise RuntimeError(f'rate: {given["rate"]!r}; give samples per second') from None


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


def parameter(text, kind):
    """Return the text of a launch argument as a parameter; what does not fit the node refuses."""
    if kind is float:
        with suppress(ValueError):
            return float(text)  # YAML takes 1e-5 for text
    return ParameterValue(TextSubstitution(text=text), value_type=str if kind is str else None)


def node(name, given, names, own):
    """Return a node that takes parameters from the launch arguments of the same names."""
    names = [*names, 'use_sim_time', 'machine_frame', 'tracker_frame']
    parameters = {
        key: is_on(given, key)
        if KINDS.get(key) is bool
        else parameter(given[key], KINDS.get(key, str))
        for key in names
    }
    respawn = is_on(given, 'respawn')
    return Node(
        package='otf_view' if name in VIEWERS else f'otf_{name}',
        executable=name,
        name=name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[LaunchConfiguration('params_file'), {**parameters, **own}],
        remappings=elsewhere(given),
        ros_arguments=['--enclave', f'/otf/{name}'],
        output='screen',
        emulate_tty=True,
        respawn=respawn,
        respawn_delay=RESPAWN_DELAY,
        on_exit=None if respawn or name in VIEWERS else partial(shut_down_on_exit, hint=AGAIN),
    )

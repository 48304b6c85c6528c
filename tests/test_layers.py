# SPDX-License-Identifier: Apache-2.0
"""Nodes stay thin, and what need not know ROS does not."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / 'src'
ROS = {'rclpy', 'otf_msgs', 'otf_ros', 'geometry_msgs', 'nav_msgs', 'std_msgs', 'std_srvs',
       'visualization_msgs'}  # fmt: skip
SIMULATING = {
    'backends/simulated.py',  # the simulated cell
    'otf_bringup/demo.py',  # draws the true errors of the simulated cell
}
NODES = sorted(f for f in SOURCE.glob('*/*/*node.py') if f.parent.name != 'test')
ROS_FREE = [
    *SOURCE.glob('otf_tracker_driver/otf_tracker_driver/*/*.py'),
    *SOURCE.glob('*/*/params.py'),
    SOURCE / 'otf_calibrator/otf_calibrator/run.py',
    SOURCE / 'otf_view/otf_view/page.py',
    SOURCE / 'otf_view/otf_view/server.py',
    *SOURCE.glob('otf_calibrator/otf_calibrator/child.py'),
    SOURCE / 'otf_calibrator/otf_calibrator/worker.py',
    SOURCE / 'otf_calibrator/otf_calibrator/session.py',
    SOURCE / 'otf_path_planner/otf_path_planner/planning.py',
]
ROS_FREE.remove(SOURCE / 'otf_ros/otf_ros/params.py')


def imported(file):
    """Top-level names of all modules that a file imports."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition('.')[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.partition('.')[0])
    return names


@pytest.mark.parametrize('file', NODES, ids=lambda file: '/'.join(file.parts[-2:]))
def test_node_is_thin(file):
    assert len(file.read_text().splitlines()) <= 150
    assert not imported(file) & {'numpy', 'scipy'}


@pytest.mark.parametrize('file', ROS_FREE, ids=lambda file: '/'.join(file.parts[-2:]))
def test_module_knows_no_ros(file):
    assert not imported(file) & ROS


def test_simulations_are_known_in_few_places_only():
    packages = [p for p in SOURCE.iterdir() if p.name != 'otf_core']
    files = [f for p in packages for f in p.rglob('*.py') if f.parent.name != 'test']
    simulating = {'/'.join(f.parts[-2:]) for f in files if 'otf_core.sim' in f.read_text()}
    assert simulating == SIMULATING


def test_packages_depend_downwards_only():
    nodes = {
        'otf_path_planner', 'otf_tracker_driver', 'otf_calibrator', 'otf_view', 'otf_compensator',
    }  # fmt: skip
    for package in nodes:
        for file in SOURCE.glob(f'{package}/**/*.py'):
            assert not imported(file) & ((nodes - {package}) | {'otf_bringup'}), file
    for file in SOURCE.glob('otf_ros/**/*.py'):
        assert not imported(file) & (nodes | {'otf_bringup'}), file


def test_quality_of_service_is_chosen_in_one_place():
    for file in SOURCE.glob('*/*/**/*.py'):
        if file.name != 'qos.py':
            assert 'QoSProfile(' not in file.read_text(), file

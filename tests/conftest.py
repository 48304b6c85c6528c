# SPDX-License-Identifier: Apache-2.0
"""Every test has a ROS domain and node processes of its own."""

from importlib import import_module

import pytest


@pytest.fixture(autouse=True, scope='session')
def local_discovery():
    """Keep all traffic on this computer."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        yield


@pytest.fixture
def graph(tmp_path):
    """An empty graph; whatever is started in it ends with the test."""
    from graph import Graph  # here: without ROS the contract is tested below this folder

    from otf_bringup.domain import free_domain

    with free_domain() as domain:
        graph = Graph(domain, tmp_path)
        try:
            yield graph
        finally:
            graph.close()


@pytest.fixture
def run_here(monkeypatch, capfd):
    """Run a node that will refuse its parameters in this process, heard by nobody.

    Returns
    -------
    callable
        Takes the name of the node and its parameters; returns exit code and all that it says.
    """
    from otf_bringup.processes import as_yaml
    from otf_ros import app

    def run(name, **parameters):
        words = [w for k, v in parameters.items() for w in ('-p', f'{k}:={as_yaml(v)}')]
        kind = {'path_planner': 'PathPlanner', 'tracker_driver': 'TrackerDriver'}.get(
            name, name.title()
        )
        node = getattr(import_module(f'otf_{name}.node'), kind)
        capfd.readouterr()
        with monkeypatch.context() as patch:
            patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF')
            code = app.run(node, ['--ros-args', *words])
        return code, ''.join(capfd.readouterr())

    return run


@pytest.fixture
def machine_file(tmp_path):
    """machine.yaml of the small machine."""
    from cells import write_machine

    return write_machine(tmp_path)

# SPDX-License-Identifier: Apache-2.0
"""Every test has a ROS domain and node processes of its own."""

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
def machine_file(tmp_path):
    """machine.yaml of the small machine."""
    from cells import write_machine

    return write_machine(tmp_path)

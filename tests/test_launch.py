# SPDX-License-Identifier: Apache-2.0
"""What all launch files share, with the real launch where it is installed, else a stand-in."""

import sys
from importlib import import_module
from types import ModuleType, SimpleNamespace

import pytest


@pytest.fixture
def launching(monkeypatch):
    """The module otf_bringup.launching."""
    try:
        import_module('launch.actions')
    except ImportError:
        module = ModuleType('launch.actions')
        module.Shutdown = lambda reason: reason
        monkeypatch.setitem(sys.modules, 'launch.actions', module)
        monkeypatch.delitem(sys.modules, 'otf_bringup.launching', raising=False)
    return import_module('otf_bringup.launching')


def test_unknown_launch_arguments_are_refused(launching, monkeypatch):
    monkeypatch.setattr(sys, 'argv', ['ros2', 'launch', 'otf_bringup', 'cell.launch.py'])
    launching.refuse_unknown(['seed'], ['seed:=3'], ('cell.launch.py',))
    with pytest.raises(RuntimeError, match=r"'sed' is unknown; did you mean 'seed'\?"):
        launching.refuse_unknown(['seed'], ['sed:=3'], ('cell.launch.py',))
    launching.refuse_unknown(['seed'], ['sed:=3'], ('other.launch.py',))  # they are not its words


def test_a_node_that_fails_fails_the_launch(launching):
    running = SimpleNamespace(is_shutdown=False)
    event = SimpleNamespace(returncode=2, process_name='planner')
    with pytest.raises(RuntimeError, match='planner ended with exit code 2'):
        launching.shut_down_on_exit(event, running)
    event = SimpleNamespace(returncode=0, process_name='planner')
    assert len(launching.shut_down_on_exit(event, running)) == 1

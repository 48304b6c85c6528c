# SPDX-License-Identifier: Apache-2.0
"""Launch files: what they start, by the real launch where it is installed, else by a stand-in."""

import runpy
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from ament_index_python.packages import get_package_share_directory

from otf_core.cli import _parser
from otf_core.config import LoopConfig

LAUNCH = Path(get_package_share_directory('otf_bringup')) / 'launch'
NAMES = {
    'launch': ('LaunchDescription',),
    'launch.actions': ('DeclareLaunchArgument', 'ExecuteProcess', 'OpaqueFunction', 'Shutdown'),
}


def recorder(name):
    """A class whose objects hold what they were made of."""

    def made(self, *words, **options):
        self.words, self.__dict__ = words, {**options, 'words': words}

    return type(name, (), {'__init__': made})


def installed():
    """Tell whether the real launch is there."""
    try:
        import_module('launch.actions')
    except ImportError:
        return False
    return True


@pytest.fixture
def loop(monkeypatch):
    """The loop's launch file, its process made from launch arguments."""
    if not installed():
        for module, names in NAMES.items():
            made = ModuleType(module)
            vars(made).update({name: recorder(name) for name in names})
            monkeypatch.setitem(sys.modules, module, made)
        monkeypatch.delitem(sys.modules, 'otf_bringup.launching', raising=False)
    monkeypatch.setattr(sys, 'argv', ['ros2', 'launch', 'otf_bringup', 'loop.launch.py'])
    content = runpy.run_path(str(LAUNCH / 'loop.launch.py'))
    declared = content['ARGUMENTS'], content['INFOS']
    known = [name for name, _, _ in declared[0]] + [info.name for info in declared[1]]
    defaults = {name: default for name, default, _ in declared[0]}
    given_none = dict.fromkeys((info.name for info in declared[1]), '')

    def process(**given):
        words = [f'{name}:={value}' for name, value in given.items()]
        context = SimpleNamespace(
            launch_configurations={**defaults, **given_none, **given}, argv=words
        )
        (action,) = content['loop'](context, known)
        return action

    return SimpleNamespace(process=process, known=known, content=content)


def command(action):
    """Words of the command that a process runs."""
    if hasattr(action, 'words'):
        return action.cmd
    return [part[0].text for part in action.cmd]


def test_every_parameter_of_the_round_is_a_launch_argument(loop):
    parameters = {info.name for info in LoopConfig.infos()}
    assert parameters <= set(loop.known)
    assert {'machine_file', 'out', 'compensate'} <= set(loop.known)


def test_launch_arguments_reach_the_command(loop):
    given = {'machine_file': 'm.yaml', 'out': 'o', 'compensate': 'axes', 'seed': '3',
             'feed': '0.25', 'error_size': '2e-5', 'overwrite': 'true'}  # fmt: skip
    words = command(loop.process(**given))
    assert words[1:4] == ['-m', 'otf_core.cli', 'loop']
    asked = _parser().parse_args(words[3:])
    assert (asked.machine, asked.out, asked.compensate) == ('m.yaml', 'o', 'axes')
    assert (asked.seed, asked.feed, asked.error_size) == (3, 15000.0, 2e-5)
    assert asked.overwrite and asked.rate is None


def test_without_arguments_the_machine_of_the_package_goes_round(loop):
    asked = _parser().parse_args(command(loop.process())[3:])
    assert Path(asked.machine).is_file()
    assert (asked.out, asked.overwrite) == ('loop', False)
    assert asked.compensate is None  # what the machine takes


def test_unknown_launch_arguments_are_refused(loop):
    with pytest.raises(RuntimeError, match=r"'sed' is unknown; did you mean 'seed'\?"):
        loop.process(sed='3')


def test_a_command_that_fails_fails_the_launch(loop):
    ended = loop.content['shut_down_on_exit']
    event = SimpleNamespace(returncode=2, process_name='loop')
    with pytest.raises(RuntimeError, match='loop ended with exit code 2'):
        ended(event, SimpleNamespace(is_shutdown=False))
    event = SimpleNamespace(returncode=0, process_name='loop')
    assert len(ended(event, SimpleNamespace(is_shutdown=False))) == 1

# SPDX-License-Identifier: Apache-2.0
"""Writes config/params.yaml: every parameter of every node with default, unit, bounds, meaning.

``python3 -m otf_bringup.params_file`` prints it; a test compares it with the file.
"""

from __future__ import annotations

import json
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import replace

from otf_calibrator.params import CalibratorConfig
from otf_compensator.params import CompensatorConfig
from otf_core.config import CalibrationConfig, ParameterInfo, Parameters, PlannerConfig
from otf_path_planner.params import PlannerFiles
from otf_ros.frames import FramesConfig
from otf_tracker_driver.backends import BACKENDS, CommonConfig
from otf_tracker_driver.params import DriverConfig
from otf_view.params import PageConfig, ViewerConfig

NODES: dict[str, tuple[type[Parameters], ...]] = {
    'path_planner': (PlannerFiles, PlannerConfig, FramesConfig),
    'tracker_driver': (DriverConfig, CommonConfig, FramesConfig),
    'calibrator': (CalibratorConfig, CalibrationConfig, FramesConfig),
    'viewer': (ViewerConfig, FramesConfig),
    'page': (PageConfig, FramesConfig),
    'compensator': (CompensatorConfig, FramesConfig),
}
NAMED: dict[str, dict[str, type[Parameters]]] = {
    'tracker_driver': {name: backend.parameters for name, backend in BACKENDS.items()},
}
"""Groups whose parameters a node declares as NAME.parameter."""
HEAD = """\
# Parameters of the nodes with their defaults, for ros2 launch ... params_file:=THIS_FILE.
# Made by `python3 -m otf_bringup.params_file`. What the launch file sets by arguments of its own
# (machine_file, backend, time_scale, output_directory, ...) wins over this file.
"""


def infos(node: str) -> Iterator[ParameterInfo]:
    """Yield what is known of every parameter of a node, by the names they have there."""
    for group in NODES[node]:
        yield from group.infos()
    for name, group in NAMED.get(node, {}).items():
        yield from (replace(info, name=f'{name}.{info.name}') for info in group.infos())


def _comment(info: ParameterInfo) -> list[str]:
    facts = [info.unit] if info.unit else []
    if info.low is not None and info.high is not None:
        facts.append(f'{info.low:.10g} to {info.high:.10g}')
    if info.choices:
        facts.append(' or '.join(info.choices))
    text = info.meaning + (f' [{", ".join(facts)}]' if facts else '')
    return textwrap.wrap(text, 99, initial_indent='    # ', subsequent_indent='    #   ')


def _value(value: object) -> str:
    """Return a value as YAML 1.1 reads it in the right type: 1e-09 has to be 1.0e-09 there."""
    text = json.dumps(value)
    if isinstance(value, float) and 'e' in text and '.' not in text:
        text = text.replace('e', '.0e')
    return text


def lines() -> Iterator[str]:
    """Yield the lines of the file."""
    yield from HEAD.splitlines()
    for node in NODES:
        yield ''
        yield f'/**/{node}:'
        yield '  ros__parameters:'
        for info in infos(node):
            yield from _comment(info)
            yield f'    {info.name}: {_value(info.default)}'


if __name__ == '__main__':
    sys.stdout.write('\n'.join(lines()) + '\n')

# SPDX-License-Identifier: Apache-2.0
"""From the planner's parameters to a plan; knows no ROS."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError, InputError
from otf_core.inputs.path_file import holds_axis_positions, read_axis_paths, read_path
from otf_core.model.axis_path import AxisPath, PartsTrack, nominal_track
from otf_core.model.machine import Machine, load_machine
from otf_core.model.plan import Plan, check_inside, plan_along
from otf_core.planning.forecast import Setup
from otf_core.planning.part_choice import planned
from otf_path_planner.params import PlannerFiles


def read_machine(files: PlannerFiles) -> Machine:
    """Read machine.yaml; ConfigError if it is not given or wrong."""
    if not files.machine_file:
        raise ConfigError('parameter machine_file: missing; give the path of machine.yaml')
    return load_machine(files.machine_file)


def check_files(files: PlannerFiles, changed: Collection[str]) -> None:
    """Refuse files that cannot be read, of those parameters that are changed.

    Raises
    ------
    ConfigError
        Names the parameter or the file that is wrong.
    """
    if 'machine_file' in changed:
        read_machine(files)
    if 'path_file' in changed and files.path_file and not Path(files.path_file).is_file():
        raise ConfigError(f'parameter path_file: {files.path_file}: no such file')


def make_plan(
    machine: Machine, files: PlannerFiles, config: PlannerConfig
) -> tuple[Plan, PartsTrack]:
    """Make the plan of ``otf plan``, or drive that of a file.

    Returns
    -------
    track : PartsTrack
        Of the reflectors.

    Raises
    ------
    ConfigError
        Names the parameter or the file that is wrong.
    """
    name = files.path_file
    try:
        plan = planned(Setup.of(machine), config) if not name else _plan_of(name, machine, config)
        check_inside(plan, machine)
        return plan, nominal_track(machine, [part.path for part in plan.parts])
    except InputError as error:
        raise ConfigError(f'{name or files.machine_file}: {error}') from None


def _plan_of(name: str, machine: Machine, config: PlannerConfig) -> Plan:
    """Plan of a file: its parts or points at the feed and with the dwells of the parameters."""
    if machine.rotary_names or holds_axis_positions(name):
        return plan_along(machine, read_axis_paths(name, machine.axis_names), config)
    return plan_along(machine, [AxisPath.of_points(machine, read_path(name)[0])], config)

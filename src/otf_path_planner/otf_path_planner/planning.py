# SPDX-License-Identifier: Apache-2.0
"""From the planner's parameters to a plan; knows no ROS."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError, InputError
from otf_core.inputs.path_file import read_axis_paths, read_path
from otf_core.model.axis_path import PartsTrack, nominal_track
from otf_core.model.machine import Machine, load_machine
from otf_core.model.path import NominalPath
from otf_core.model.plan import AxisPlan, Plan, check_inside, plan_for_path
from otf_core.planning.part_choice import axis_plan, planned_parts
from otf_core.planning.path_creation import plan_path
from otf_core.planning.rotary_paths import PlannedPart
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


def make_plan(machine: Machine, files: PlannerFiles, config: PlannerConfig) -> tuple[Plan, int]:
    """Plan for a machine with linear axes alone.

    Returns
    -------
    passes : int
        How often the path is driven.

    Raises
    ------
    ConfigError
        Names the parameter or the file that is wrong.
    """
    if not files.path_file:
        return plan_path(machine, config), config.passes
    try:
        path = NominalPath(read_path(files.path_file)[0])
        check_inside(path, machine)
    except InputError as error:
        raise ConfigError(f'{files.path_file}: {error}') from None
    return plan_for_path(path, config), 1


def make_axis_plan(
    machine: Machine, files: PlannerFiles, config: PlannerConfig
) -> tuple[AxisPlan, PartsTrack]:
    """Plan for a machine with rotary axes: the parts of ``otf plan``, or of a file.

    Returns
    -------
    track : PartsTrack
        Of the reflectors.

    Raises
    ------
    ConfigError
        Names the parameter or the file that is wrong.
    """
    try:
        if files.path_file:
            own = read_axis_paths(files.path_file, machine.axis_names)
            parts = [PlannedPart(path.of(machine), 0.0, '') for path in own]
        else:
            parts = planned_parts(machine, config)
        track = nominal_track(machine, [part.path for part in parts])
    except InputError as error:
        raise ConfigError(f'{files.path_file or files.machine_file}: {error}') from None
    return axis_plan(machine, parts, config), track

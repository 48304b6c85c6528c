# SPDX-License-Identifier: Apache-2.0
"""From the planner's parameters to a plan; knows no ROS."""

from __future__ import annotations

from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError, InputError
from otf_core.inputs.path_file import read_path
from otf_core.model.machine import Machine, load_machine
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan, check_inside, plan_for_path
from otf_core.planning.path_creation import plan_path
from otf_path_planner.params import PlannerFiles


def make_plan(files: PlannerFiles, config: PlannerConfig) -> tuple[Machine, Plan, int]:
    """Read the files and plan.

    Returns
    -------
    passes : int
        How often the path is driven.

    Raises
    ------
    ConfigError
        Names the parameter or the file that is wrong.
    """
    if not files.machine_file:
        raise ConfigError('parameter machine_file: missing; give the path of machine.yaml')
    machine = load_machine(files.machine_file)
    if not files.path_file:
        return machine, plan_path(machine, config), config.passes
    try:
        path = NominalPath(read_path(files.path_file)[0])
        check_inside(path, machine)
    except InputError as error:
        raise ConfigError(f'{files.path_file}: {error}') from None
    return machine, plan_for_path(path, config), 1

# SPDX-License-Identifier: Apache-2.0
"""Parameters of the planner node, besides those of the path itself (PlannerConfig)."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.config import Parameters, parameter


@dataclass(frozen=True)
class PlannerFiles(Parameters):
    """Files that the planner reads at start and at every ``planner/replan``."""

    machine_file: str = parameter('', 'machine description (machine.yaml); required')
    path_file: str = parameter(
        '', 'path to drive instead of a created one: CSV of corner points with the header x,y,z, '
        'in m, plan.json or NC program; of a machine with rotary axes CSV with the header '
        'target,x,y,z,a,c, in m and rad; empty: create the path',
    )  # fmt: skip

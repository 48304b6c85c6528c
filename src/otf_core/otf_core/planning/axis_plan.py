# SPDX-License-Identifier: Apache-2.0
"""Parts of a machine with rotary axes with the feeds and dwells at which they are driven."""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.config import PlannerConfig
from otf_core.model.axis_path import AxisPath
from otf_core.model.machine import Machine
from otf_core.model.plan import AxisPlan
from otf_core.planning.rotary_paths import LEVER, TURN_RATE, PlannedPart, duration_of


def axis_plan(machine: Machine, parts: Sequence[PlannedPart], config: PlannerConfig) -> AxisPlan:
    """Plan to drive parts: feeds as in the forecast, dwells of the parts or of all corners."""
    return AxisPlan(
        tuple(part.path for part in parts),
        tuple(_feed(machine, part.path, config) for part in parts),
        tuple(part.dwell or config.corner_dwell for part in parts),
        tuple(part.dwell > 0.0 for part in parts),
        sum(duration_of(machine, part, config) for part in parts),
    )


def _feed(machine: Machine, part: AxisPath, config: PlannerConfig) -> float:
    """Feed of a part, m/s; rotary axes turn no faster than ``TURN_RATE``."""
    turning = [machine.column(axis) for axis in machine.rotary_names]
    turns = bool((part.positions[:, turning] != part.positions[0, turning]).any())
    return min(config.feed, float(TURN_RATE) * LEVER) if turns else config.feed

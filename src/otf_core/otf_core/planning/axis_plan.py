# SPDX-License-Identifier: Apache-2.0
"""Parts of a machine with rotary axes: which are driven, and at what feeds and dwells."""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.arrays import Array
from otf_core.config import ForecastConfig, PlannerConfig
from otf_core.model.axis_path import LEVER, AxisPath
from otf_core.model.machine import Machine
from otf_core.model.plan import AxisPlan
from otf_core.noise.noise_model import NoiseModel
from otf_core.planning.axis_programs import on_axis_increment
from otf_core.planning.part_choice import choose_parts
from otf_core.planning.rotary_paths import (
    TURN_RATE,
    PlannedPart,
    default_tracker_place,
    duration_of,
)


def planned_parts(
    machine: Machine,
    config: PlannerConfig,
    place: Array | None = None,
    judged: ForecastConfig | None = None,
    noise: NoiseModel | None = None,
    time_budget: float | None = None,
) -> list[PlannedPart]:
    """Parts to drive, at positions that a program can state; see ``part_choice.choose_parts``.

    Parameters
    ----------
    place : ndarray, shape (3,), m, optional
        Beam origin in the frame of the tracker's link; by default ``default_tracker_place``.
    """
    at = default_tracker_place(machine) if place is None else place
    judged = judged or ForecastConfig()
    chosen = choose_parts(machine, at, config, judged, noise, time_budget)
    return [on_axis_increment(machine, part) for part in chosen]


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

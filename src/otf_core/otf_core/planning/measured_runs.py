# SPDX-License-Identifier: Apache-2.0
"""Runs that were measured already, beside a planned one: rows of all of them together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.engine.residual_rows import Rows, rows_of
from otf_core.errors import ConfigError, OtfError
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan
from otf_core.pieces.observed import Observed
from otf_core.planning.forecast import Setup, forecast, tracker_pose
from otf_core.planning.planned_budget import Planned
from otf_core.solving.joint import SolvedRun
from otf_core.solving.solution import Solution
from otf_core.solving.system import build_system
from otf_core.solving.unknowns import layout
from otf_core.solving.whitener import Whitener
from otf_core.tracking.curves import straight_shape


@dataclass(frozen=True)
class MeasuredRun:
    """A run that was measured.

    Attributes
    ----------
    plan : Plan
        As it was driven.
    place : ndarray, shape (3,), m
        Of the tracker.
    """

    plan: Plan
    place: Array

    @classmethod
    def of(cls, data: Mapping[str, Any], where: str) -> MeasuredRun:
        """Read an entry of gap.json; ConfigError if it is none."""
        try:
            points = np.array(data['path'], dtype=float)
            feed = np.array(data['feed'], dtype=float)
            place = np.array(data['tracker_place'], dtype=float)
            plan = Plan(NominalPath(points), feed, np.zeros(len(points)))
            if place.shape != (3,) or not np.all(np.isfinite(place)):
                raise ValueError('tracker_place')
        except (KeyError, TypeError, ValueError, OtfError) as error:
            raise ConfigError(f'{where}: measured: cannot be read ({error})') from None
        return cls(plan, place)

    def observed(self, setup: Setup) -> Observed:
        """What the run shows, by its path alone."""
        own = setup.at(self.place)
        return Observed(
            machine=own.machine,
            shape=straight_shape(self.plan.path.points),
            pieces=forecast(self.plan, own).pieces,
            pose=tracker_pose(own),
            noise=own.noise,
        )


def joint_rows(planned: Planned, before: Sequence[Observed], limit: float) -> Rows:
    """Rows of a planned run and of those before it, with zero deviations and common tables."""
    observed, done, _ = planned
    runs = [observed, *before]
    unknowns = layout(done.unknowns.bases, len(runs))
    solved = []
    for number, run in enumerate(runs):
        system = build_system(run.machine, run.pieces, run.pose, unknowns, run=number)
        whitener = Whitener.of(system, run.pieces, run.noise)
        solved.append(SolvedRun(run.pose, system, whitener, np.zeros_like(system.deviation)))
    nothing = np.zeros(unknowns.full)
    solution = Solution(
        nothing, np.outer(nothing, nothing), done.solution.accepted, 0, np.zeros((0, 0))
    )
    joint = replace(done, unknowns=unknowns, solution=solution, runs=tuple(solved))
    return rows_of(runs, joint, limit)

# SPDX-License-Identifier: Apache-2.0
"""A plan with all that is known of it before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from otf_core.model.plan import Plan
from otf_core.planning.follow_up import Answer
from otf_core.planning.forecast import Forecast, Setup
from otf_core.planning.observability import Unseen
from otf_core.planning.planned_budget import PlannedSystematic
from otf_core.planning.tracker_places import TrackerPlace


@dataclass(frozen=True)
class EffectForecast:
    """How well a plan would show one effect beyond the rigid body.

    Attributes
    ----------
    effect : str
        Name in gap.json.
    words : str
        One line for forecast.txt.
    data : mapping
        Entry for plan.json.
    """

    effect: str
    words: str
    data: Mapping[str, Any]


@dataclass(frozen=True)
class PlanReport:
    """A plan with all that is known of it before anything moves.

    Attributes
    ----------
    plan : Plan
    how : str
        How the path came about, one line.
    setup : Setup
    forecast : Forecast
    findings : tuple of Unseen
    places : tuple of TrackerPlace
        Ranked places of the tracker.
    advice : tuple of str
    effects : tuple of EffectForecast
    systematic : PlannedSystematic, optional
        The grid with systematic contributions; everything else is noise only.
    after : tuple of Answer
        What the plan would say to the questions that a diagnosis left open.
    """

    plan: Plan
    how: str
    setup: Setup
    forecast: Forecast
    findings: tuple[Unseen, ...]
    places: tuple[TrackerPlace, ...]
    advice: tuple[str, ...]
    effects: tuple[EffectForecast, ...] = field(default=())
    systematic: PlannedSystematic | None = None
    after: tuple[Answer, ...] = ()

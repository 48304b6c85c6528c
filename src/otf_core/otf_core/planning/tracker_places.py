# SPDX-License-Identifier: Apache-2.0
"""Where to put the tracker: places around and above the volume, compared by forecast.

Rows are perpendicular to the path wherever the tracker stands: a place changes how well errors
are seen, not which. So the errors judged are those that are seen from the place assumed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.evaluation import covered_grid, free_rows
from otf_core.model.frames import XYZ
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS
from otf_core.model.nodes import table_nodes
from otf_core.model.plan import Plan
from otf_core.planning.candidate_lines import INTERVALS
from otf_core.planning.forecast import BESIDE, Setup, equal_pieces, forecast_pieces, tracker_pose
from otf_core.prediction.uncertainty import prediction_rows
from otf_core.solving.normal import normal_equations
from otf_core.solving.roughness import expected_precision
from otf_core.solving.shape_choice import smooth_bases
from otf_core.solving.solution import solve
from otf_core.solving.system import build_system
from otf_core.solving.tabulate import table_rows
from otf_core.solving.unknowns import layout
from otf_core.solving.whitener import Whitener

_PART = 0.5
"""Part of an interval of the splines that a piece may span to compare places."""
_JUDGED = 5
"""Points per axis of the grid that places are compared on, at most."""


@dataclass(frozen=True)
class TrackerPlace:
    """One place and what the plan would show from there.

    Attributes
    ----------
    place : ndarray, shape (3,), m
        Beam origin in the machine frame.
    words : str
    mean_grid_u : float
        m; forecast with splines of ``candidate_lines.INTERVALS`` parts per axis.
    shortest, longest : float
        m; beam over the path.
    """

    place: Array
    words: str
    mean_grid_u: float
    shortest: float
    longest: float


def beam_lengths(plan: Plan, place: Array) -> tuple[float, float]:
    """Shortest and longest beam over the path, m."""
    start, step = plan.path.points[:-1], np.diff(plan.path.points, axis=0)
    length = np.maximum(np.einsum('ij,ij->i', step, step), 1e-18)
    share = np.clip(np.einsum('ij,ij->i', place - start, step) / length, 0.0, 1.0)
    near = np.linalg.norm(start + share[:, None] * step - place, axis=1).min()
    far = np.linalg.norm(plan.path.points - place, axis=1).max()
    return float(near), float(far)


def advice(places: list[TrackerPlace], own: float) -> list[str]:
    """Say in words where the tracker stands best.

    Parameters
    ----------
    places : list of TrackerPlace
        Ranked.
    own : float
        m; mean grid uncertainty from the place that the plan is made for, judged likewise.
    """
    if not places:
        return ['no place around the volume keeps all beams within the range limits']
    best, worst = places[0], places[-1]
    x, y, z = (f'{1e3 * v:.0f}' for v in best.place)
    return [
        f'best of {len(places)} places: {best.words} ({x}, {y}, {z}) mm: '
        f'{best.mean_grid_u / own:.2f} times the mean grid uncertainty of the place assumed here',
        f'worst: {worst.words}: {worst.mean_grid_u / own:.2f} times',
        'the nearer the better, as far as the range limits and a free beam allow; '
        'that the beam is free and the target looks at the tracker is not checked',
    ]


def judge_places(plan: Plan, setup: Setup, accepted: tuple[str, ...]) -> Callable[[Array], float]:
    """Set up the comparison of places for one plan.

    Parameters
    ----------
    plan : Plan
    setup : Setup
    accepted : tuple of str
        Blocks of unknowns that the plan shows, see ``Forecast.solution``.

    Returns
    -------
    callable(place) -> float
        Mean grid uncertainty, m, with the tracker at a place (3,), m.
    """
    machine, limit, points = (
        setup.machine,
        setup.calibration.unidentifiable_above,
        plan.path.points,
    )
    nodes = table_nodes(machine, points.min(axis=0), points.max(axis=0))
    unknowns = layout(smooth_bases(nodes, INTERVALS))
    prior = expected_precision(unknowns, limit, setup.config.error_size)
    grid = covered_grid(machine, points, min(setup.config.grid, _JUDGED))
    tables = prediction_rows(machine, {m: nodes[m.axis] for m in MOTIONS}, grid)
    free = free_rows(tables.reshape(-1, tables.shape[2]), grid)
    rows = free @ table_rows(unknowns, nodes)
    cut = equal_pieces(unknowns.knots, _PART, setup.calibration.piece_length)
    pieces = forecast_pieces(plan, cut, setup)

    def mean_grid_u(place: Array) -> float:
        seen = replace(pieces, xyz=pieces.xyz + (setup.place - place))
        system = build_system(machine, seen, tracker_pose(setup.at(place)), unknowns)
        normal = normal_equations(system, unknowns, Whitener.of(system, seen, setup.noise))
        covariance = solve(normal, unknowns, limit, accepted, prior).covariance
        variance = np.einsum('ij,ij->i', rows @ covariance, rows).reshape(-1, 3).sum(axis=1)
        return float(np.sqrt(np.maximum(variance, 0.0)).mean())

    return mean_grid_u


def check_place(plan: Plan, setup: Setup) -> None:
    """Refuse a place whose beams leave the range limits; ConfigError says by how much."""
    near, far = beam_lengths(plan, setup.place)
    low, high = setup.config.min_range, setup.config.max_range
    if near < low or far > high:
        raise ConfigError(
            f'tracker_place: beams from {setup.place.tolist()} m to the path are {near:.3f} m to '
            f'{far:.3f} m long; the tracker measures {low:g} m to {high:g} m'
        )


def _words(side: tuple[int, ...], distance: float) -> str:
    signs = ''.join(
        f'{"+" if s > 0 else "-"}{a}' for a, s in zip(XYZ[:2], side[:2], strict=True) if s
    )
    if not signs:
        return f'above the middle, {distance:.2f} m away'
    height = 'at half height' if side[2] == 0 else 'and above'
    where = 'beyond the edge' if len(signs) > 2 else 'on the side'
    return f'{where} {signs} {height}, {distance:.2f} m away'


def candidate_places(machine: Machine, near: float) -> list[tuple[Array, str]]:
    """Places on every side, beyond every edge and above; with words.

    Parameters
    ----------
    machine : Machine
    near : float
        m, from the working volume; on the sides also twice as far.
    """
    centre = 0.5 * (machine.lower + machine.upper)
    half = 0.5 * (machine.upper - machine.lower)
    found = []
    for distance, x, y, z in product((near, 2 * near), (-1, 0, 1), (-1, 0, 1), (0, 1)):
        side = np.array([x, y, z])
        if side.any() and (distance == near or np.abs(side).sum() == 1):
            away = distance * side / np.linalg.norm(side)
            found.append((centre + side * half + away, _words((x, y, z), distance)))
    return found


def compare_places(
    plan: Plan, setup: Setup, judge: Callable[[Array], float]
) -> list[TrackerPlace]:
    """Rank places of the tracker for one plan.

    Parameters
    ----------
    plan : Plan
    setup : Setup
        Its own place is left out.
    judge : callable
        See ``judge_places``.

    Returns
    -------
    list of TrackerPlace
        Best first; places whose beams leave the range limits are not listed. That the beam is
        free and the target looks at the tracker is not checked.
    """
    limits = setup.config
    near = max(BESIDE, limits.min_range)
    found = []
    for place, words in candidate_places(setup.machine, near):
        shortest, longest = beam_lengths(plan, place)
        if shortest >= limits.min_range and longest <= limits.max_range:
            found.append(TrackerPlace(place, words, judge(place), shortest, longest))
    return sorted(found, key=lambda p: p.mean_grid_u)

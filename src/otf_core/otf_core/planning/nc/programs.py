# SPDX-License-Identifier: Apache-2.0
"""The program of a plan in a dialect: approach, order, rounding, checks.

A program drives to the start above the path, waits there for the recording to start, and drives
the plan with exact stop and dwell at every corner point. All positions are machine coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan
from otf_core.planning.nc.dialect import Dialect, comment_lines

INCREMENT = 1e-6
"""m; resolution of the positions in a program."""
LARGEST_POSITION = 99.999999
"""m; more than five digits before the decimal point of a mm are refused."""


def round_to_increment(plan: Plan, low: Array, high: Array) -> Plan:
    """Round the points of a plan to what a program can say, inside the axis ranges.

    Parameters
    ----------
    low, high : ndarray, shape (3,), m
        Ends of the axis ranges.
    """
    inner_low = np.ceil(low / INCREMENT - 1e-3)
    inner_high = np.floor(high / INCREMENT + 1e-3)
    points = np.clip(np.rint(plan.path.points / INCREMENT), inner_low, inner_high)
    return Plan(NominalPath(points / round(1 / INCREMENT)), plan.feed, plan.dwell)


def _check(dialect: Dialect, plan: Plan) -> None:
    points = plan.path.points
    off = np.abs(points - np.rint(points / INCREMENT) * INCREMENT).max()
    if off > 1e-9:
        raise ConfigError(
            f'{dialect.name}: the path has positions between the increments of '
            f'{1e3 * INCREMENT:g} mm'
        )
    if np.abs(points).max() > LARGEST_POSITION:
        raise ConfigError(f'{dialect.name}: positions beyond {1e3 * LARGEST_POSITION:.3f} mm')
    feeds = np.rint(plan.feed * 60e3)
    if feeds.min() < 1:
        slow = 60e3 * plan.feed.min()
        raise ConfigError(f'{dialect.name}: a feed of {slow:.3g} mm/min rounds to 0')
    if plan.dwell.max() > dialect.longest_dwell:
        raise ConfigError(
            f'{dialect.name}: a dwell of {plan.dwell.max():g} s; the longest is '
            f'{dialect.longest_dwell:g} s'
        )
    if dialect.needs_dwell and plan.dwell.min() < 1e-3:
        raise ConfigError(
            f'{dialect.name}: has no exact stop; give a corner_dwell above 0, which stops there'
        )


def program(dialect: Dialect, plan: Plan, header: Sequence[str]) -> str:
    """Write the program of a plan.

    Parameters
    ----------
    plan : Plan
        Positions on the increment of the dialect, see ``round_to_increment``.
    header : sequence of str
        Comments, each of one line or more.

    Raises
    ------
    ConfigError
        If the dialect cannot express the plan.
    """
    _check(dialect, plan)
    points = 1e3 * plan.path.points
    feeds = np.rint(plan.feed * 60e3).astype(int)
    start, slow = points[0], int(feeds.min())
    top = start.copy()
    top[2] = points[:, 2].max()
    lines = dialect.begin([line for text in header for line in comment_lines(text)])
    lines.append(dialect.comment('APPROACH: Z TO THE TOP OF THE PATH, THEN TO ITS START'))
    lines += [dialect.move(axes, top, slow) for axes in ('Z', 'XY')]
    lines.append(dialect.move('Z', start, slow))
    lines.append(dialect.comment('LOCK THE BEAM, START RECORDING, THEN GO ON'))
    lines += dialect.wait()
    for k, point in enumerate(points):
        moves = k > 0 and np.any(point != points[k - 1])
        if moves:
            lines.append(dialect.move('XYZ', point, int(feeds[k - 1])))
        if plan.dwell[k] >= 1e-3:
            lines += dialect.dwell(float(plan.dwell[k]))
    return '\n'.join(dialect.finished(lines + dialect.end())) + '\n'

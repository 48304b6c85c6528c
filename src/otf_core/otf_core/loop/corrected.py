# SPDX-License-Identifier: Apache-2.0
"""Corrected NC program: for controls that have no table for the volumetric error.

Every line is cut into parts, and the ends of the parts are moved by minus the error there. The
parts are blended within ``TOLERANCE``; at the corner points of the nominal path the machine stops
by its dwell as before.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.exports.base import Field
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan
from otf_core.planning.nc.linuxcnc import LinuxCnc
from otf_core.planning.nc.programs import program

PART = 0.01
"""m; longest part of a line."""
TOLERANCE = 1e-7
"""m; blending between parts (G64 P)."""


class _Corrected(LinuxCnc):
    """Positions of 0.1 um, which the interpreter takes like any number."""

    decimals = 4


INCREMENT = 1e-7
"""m; of these positions."""


def in_parts(plan: Plan) -> Plan:
    """Cut every leg of a plan into parts of at most ``PART``; only its own corners dwell."""
    points, feed, dwell = [plan.path.points[0]], [], [plan.dwell[0]]
    for k, length in enumerate(plan.path.leg_lengths):
        count = max(1, int(np.ceil(length / PART)))
        share = np.arange(1, count + 1)[:, None] / count
        start, end = plan.path.points[k], plan.path.points[k + 1]
        points.extend(start + share * (end - start))
        feed.extend([plan.feed[k]] * count)
        dwell.extend([0.0] * (count - 1) + [plan.dwell[k + 1]])
    return Plan(NominalPath(np.array(points)), np.array(feed), np.array(dwell))


def corrected(parts: Plan, held: Field) -> Plan:
    """Move the points of a plan by minus the error, to the increment of a program.

    Parameters
    ----------
    parts : Plan
        See ``in_parts``.
    held : callable
        Error at positions, m.
    """
    nominal = parts.path.points
    moved = nominal - held(nominal)
    moved -= (moved - nominal)[0]  # the zero point of the program is that of the nominal path
    points = np.rint(moved / INCREMENT) / round(1 / INCREMENT)
    return Plan(NominalPath(points), parts.feed, parts.dwell)


def corrected_program(plan: Plan, header: Sequence[str]) -> str:
    """Program for LinuxCNC: parts blended, stops by dwell."""
    text = program(_Corrected(), plan, header)
    return text.replace('\nG61.1\n', f'\nG64 P{1e3 * TOLERANCE:.6f}\n', 1)

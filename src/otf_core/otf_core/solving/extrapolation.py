# SPDX-License-Identifier: Apache-2.0
"""What the motions that were seen say of motions where no data hold them; see ``table_prior``.

Beyond the ends of its table a motion goes on with its mean slope (tables are constant there) and
with waves of the size and length that its own data show. Motions and squareness errors that the
data do not see are taken to be as large as those that they see; translations of an axis that does
not move (a single plane) grow with the distance from where it stands.
"""

from __future__ import annotations

import numpy as np

from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion
from otf_core.model.tables import ErrorTables
from otf_core.prediction.table_prior import MotionPrior
from otf_core.solving.joint import JointSolution
from otf_core.solving.roughness import waves_of

USUAL = 2e-5
"""rad; size of rotations, squareness errors and slopes where none is seen at all."""


def prior_of(done: JointSolution, tables: ErrorTables, limit: float) -> dict[str, MotionPrior]:
    """Size of all motions where no data hold them.

    Parameters
    ----------
    done : JointSolution
    tables : ErrorTables
        Of it.
    limit : float
        m and rad; ``unidentifiable_above``.

    Returns
    -------
    mapping of motion or squareness error to MotionPrior
        All motions; of squareness errors those that are not seen.
    """
    found: dict[str, MotionPrior] = {
        m: _seen(done, tables, m, limit) for m in MOTIONS if m in done.roughness.logs
    }
    rotations = [m for m in MOTIONS if m in found and not m.is_translation]
    size = _root_mean_square([v for m in rotations for v in tables.motions[m].value])
    slope = _root_mean_square([found[m].slope for m in rotations])
    translations = {m: found[m] for m in MOTIONS if m in found and m.is_translation}
    for motion in MOTIONS:
        if motion not in found and not motion.is_translation:
            found[motion] = MotionPrior(slope=slope, sd=size or USUAL)
        elif motion not in found:
            found[motion] = _alike(translations, motion)
    tilts = [tables.squareness[n].value for n in SQUARENESS if n in done.solution.accepted]
    for name in SQUARENESS:
        if name not in done.solution.accepted:
            found[name] = MotionPrior(sd=_root_mean_square(tilts) or USUAL)
    return found


def _alike(seen: dict[ErrorMotion, MotionPrior], motion: ErrorMotion) -> MotionPrior:
    """Translation that is not seen, like those that are."""
    if not seen:
        return MotionPrior(slope=USUAL)
    slopes = [p.slope for m, p in seen.items() if m.is_positioning]
    return MotionPrior(
        0.0 if motion.is_straightness else _root_mean_square(slopes) or USUAL,
        _root_mean_square([p.intensity for p in seen.values()]),
        _root_mean_square([p.sd for p in seen.values()]),
        float(np.median([p.length for p in seen.values()])),
    )


def _root_mean_square(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else 0.0


def _seen(
    done: JointSolution, tables: ErrorTables, motion: ErrorMotion, limit: float
) -> MotionPrior:
    knots, table = done.unknowns.knots[motion.axis], tables.motions[motion]
    waves = waves_of(done.roughness.logs[motion], knots, limit)
    slope = 0.0  # that of a straightness lies in squareness, which goes on
    if not motion.is_straightness:
        slope = abs(float(table.value[-1] - table.value[0])) / float(knots[-1] - knots[0])
    return MotionPrior(slope, waves.intensity, waves.sd, waves.length)

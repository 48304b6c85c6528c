# SPDX-License-Identifier: Apache-2.0
"""Which motions differ between both senses of travel, as backlash does: a constant each.

All motions of all axes get half a constant with the sign of the last travel of their axis; those
whose constant is significant are kept, and the tables hold the mean of both senses. At one feed
a lag of one axis behind the others looks the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.config import CalibrationConfig
from otf_core.model.motions import ErrorMotion
from otf_core.rotary.solution import AxisSolution
from otf_core.solving.unknowns import reversal_block

SIGNIFICANT = 5.0
"""Standard uncertainties; by chance one of thirty constants exceeds them in 60 000 runs."""
LEAST = 3e-7
"""m and rad; smaller differences are left in the residuals."""
NONE, CONSTANT = 'none', 'constant'


@dataclass(frozen=True)
class AxisReversal:
    """Forward less backward travel of one motion, m or rad, and its standard uncertainty."""

    motion: ErrorMotion
    value: float
    u: float


def reversals(joint: AxisSolution, factor: float = 1.0) -> list[AxisReversal]:
    """Constants of a solution; ``factor`` on its covariance."""
    values = []
    for motion in joint.machine.motions:
        block = joint.unknowns.blocks.get(reversal_block(motion, 0))
        if block is not None:
            k = block.start
            u = float(np.sqrt(max(factor * joint.solution.covariance[k, k], 0.0)))
            values.append(AxisReversal(motion, float(joint.solution.value[k]), u))
    return values


def significant(joint: AxisSolution, config: CalibrationConfig) -> tuple[str, ...]:
    """Motions to keep a constant of, from a solution with one for every motion."""
    limit = config.unidentifiable_above
    known = [r for r in reversals(joint) if r.u < limit]
    if config.reversal != 'auto':
        return tuple(str(r.motion) for r in known)
    return tuple(str(r.motion) for r in known if abs(r.value) > max(SIGNIFICANT * r.u, LEAST))

# SPDX-License-Identifier: Apache-2.0
"""Whether the path was followed, and which parts of it are missing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.calibration.calibrate import MIN_COVERAGE
from otf_core.checking.checked import Check, Checked, errors, warnings
from otf_core.checking.seen import Seen
from otf_core.model.observation import Samples
from otf_core.model.path import Legs, NominalPath
from otf_core.tracking.alignment import Alignment
from otf_core.tracking.driving_order import OFF_PATH

WHOLE = 0.98
"""Driven share from which on nothing is said."""
SHORT = 4.0
"""Corner exclusions; a leg no longer is not looked for."""
HALF = 0.5
"""Share of a leg between its corners that has to be seen."""
SHOWN = 3


def _ask(seen: Seen) -> Checked:
    found = seen.alignment
    coverage = 0.0 if found is None else found.coverage
    facts = {'coverage': coverage, 'legs_missing': 0}
    reasons = dict.fromkeys(seen.why(step) for step in ('following', 'run'))  # often the same
    problems = errors(*reasons)
    if found is None or seen.samples is None or seen.path is None:
        return Checked('', facts, problems)
    missing = _missing(seen.samples, seen.path, found, seen.config.corner_exclusion)
    facts['legs_missing'] = len(missing)
    if coverage < WHOLE:
        corners = 1e3 * seen.path.corners()[0]
        which = ', '.join(
            f'{k + 1} from ({_place(corners[k])}) to ({_place(corners[k + 1])}) mm'
            for k in missing[:SHOWN]
        )
        legs = f'; missing legs: {which}{", ..." if len(missing) > SHOWN else ""}'
        text = (
            f'only {100 * coverage:.1f} % of the path was recorded'
            f'{legs if missing else ""}; drive the rest, into the same recording or another one'
        )
        problems += errors(text) if coverage < MIN_COVERAGE else warnings(text)
    end = '' if found.last_leg_driven or coverage < WHOLE else ', but not to its end'
    return Checked(f'{100 * coverage:.1f} % of the path driven{end}', facts, problems)


def _place(point: NDArray[np.float64]) -> str:
    return ', '.join(f'{v:.0f}' for v in point + 0.0)


def _missing(samples: Samples, path: NominalPath, found: Alignment, margin: float) -> list[int]:
    """Legs of the published path of which less than half was seen."""
    legs = Legs(path.corners()[0])
    on = found.leg != OFF_PATH
    number = found.leg[on]
    published = number if found.published is None else found.published[number]
    on, number = np.flatnonzero(on)[published != OFF_PATH], published[published != OFF_PATH]
    along = legs.along(found.T_machine_tracker.apply(samples.xyz[on]), number)
    low, high = np.full(len(legs.length), np.inf), np.full(len(legs.length), -np.inf)
    np.minimum.at(low, number, along)
    np.maximum.at(high, number, along)
    seen = np.where(high > low, high - low, 0.0)
    long = legs.length > SHORT * margin
    return np.flatnonzero(long & (seen < HALF * (legs.length - 2 * margin))).tolist()


FOLLOWING = Check('path', _ask)

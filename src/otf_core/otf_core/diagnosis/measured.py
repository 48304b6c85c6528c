# SPDX-License-Identifier: Apache-2.0
"""What was measured, for those who plan what to measure next: path, feeds, place of the tracker.

Corners are taken half-way between the last piece of a leg and the first of the next: near corners
nothing is used.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from otf_core.diagnosis.place.views import RunView


def measured_run(view: RunView) -> dict[str, Any]:
    """Corner points, m, feeds of the legs, m/s, and place of the tracker, m, of one run."""
    first = np.flatnonzero(np.diff(view.leg, prepend=view.leg[0] - 1))
    last = np.append(first[1:], len(view.leg)) - 1
    between = 0.5 * (view.q[last[:-1]] + view.q[first[1:]])
    path = np.vstack([view.q[first[:1]], between, view.q[last[-1:]]])
    feed = [float(np.max(view.speed[a : b + 1])) for a, b in zip(first, last, strict=True)]
    return {
        'tracker_place': np.median(view.q - view.beam, axis=0).tolist(),
        'path': np.round(path, 6).tolist(),
        'feed': feed,
    }

# SPDX-License-Identifier: Apache-2.0
"""Target offsets that the data of runs with different ones contradict.

With one offset a wrong one cannot be seen: rotations times a constant lever are translations of
the same axis, and what is predicted at that target stays right. Between runs the difference of
the offsets counts; signs of its parts are tried.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from otf_core.arrays import Array
from otf_core.contradictions.chain import ALIKE, BAD, BETTER
from otf_core.contradictions.quick_model import Model
from otf_core.pieces.finding import GATE, Finding

SAME = 1e-4
"""m; offsets that differ by less show nothing."""


def check_target_offset(model: Model) -> list[Finding]:
    """Try other signs of the target offsets where runs with different ones fit badly together."""
    offsets = model.offsets
    if model.fit.ratio < BAD or np.ptp(offsets, axis=0).max() < SAME:
        return []
    tried = _flips(offsets)
    chain = model.rows.machine.chain
    left = model.left_with([chain] * (len(tried) + 1), [offsets, *(t.offsets for t in tried)])
    stated, others = left[0], left[1:]
    if not tried or others.min() > BETTER * stated:
        return []
    named = '; or '.join(
        f'{_metres(tried[k].right)} in place of {_metres(tried[k].stated)} '
        f'({1e6 * others[k]:.2f} um)'
        for k in np.argsort(others)
        if others[k] < ALIKE * others.min()
    )
    return [Finding('target offset', GATE, (
        f'as stated the runs fit together to {1e6 * stated:.2f} um, with another sign '
        f'better: {named}; correct target_offset'
    ))]  # fmt: skip


@dataclass(frozen=True)
class _Flip:
    """One group of runs with other signs: what was stated, what is tried, all offsets then."""

    stated: Array
    right: Array
    offsets: Array


def _flips(offsets: Array) -> list[_Flip]:
    """Other signs of the offset of each group of runs with the same one."""
    found = []
    for offset in np.unique(np.round(offsets / SAME), axis=0) * SAME:
        member = np.abs(offsets - offset).max(axis=1) < SAME
        free = [(1.0, -1.0) if abs(v) > SAME else (1.0,) for v in offset]
        for signs in list(product(*free))[1:]:
            moved = np.where(member[:, None], np.array(signs) * offsets, offsets)
            found.append(_Flip(offset, np.array(signs) * offset, moved))
    return found


def _metres(offset: Array) -> str:
    return f'[{", ".join(f"{v:g}" for v in np.round(offset, 6))}] m'

# SPDX-License-Identifier: Apache-2.0
"""A chain in machine.yaml that the data contradict.

A rotation acts through the travels of the axes beyond it. Its own travel acts like a translation
of the same axis, so the place of the base b in the chain changes what is called straightness and
positioning, never what fits: the data tell the order of the axes from workpiece to tool, six
classes of four chains each.
"""

from __future__ import annotations

from otf_core.contradictions.quick_model import Model
from otf_core.model.machine import Chain
from otf_core.pieces.finding import GATE, Finding

BAD = 1.3
"""Residual over noise from which on other chains are tried."""
BETTER = 0.7
"""Residual of another order, over that of the stated one, that contradicts it."""
ALIKE = 1.15
"""Residuals over the best that fit as well."""


def chains_of(order: tuple[str, ...]) -> tuple[str, ...]:
    """The four chains of one order."""
    return tuple(str(Chain(order[:k], order[k:])) for k in range(len(order) + 1))


def check_chain(model: Model) -> list[Finding]:
    """Try all orders of axes where the stated chain fits badly."""
    if model.fit.ratio < BAD:
        return []
    chain, left = model.rows.machine.chain, model.left_by_order
    stated = (*chain.table_side, *chain.target_side)
    best = min(left.values())
    if best > BETTER * left[stated]:
        return []
    fits = sorted((o for o in left if left[o] < ALIKE * best), key=lambda o: left[o])
    named = '; or '.join(
        f'{" ".join(o)} ({1e6 * left[o]:.2f} um: {", ".join(chains_of(o))})' for o in fits
    )
    return [Finding('chain', GATE, (
        f'{model.rows.machine.chain} leaves {1e6 * left[stated]:.2f} um; other orders of axes '
        f'from workpiece to tool leave less: {named}. The place of b cannot be seen in data; '
        f'correct the chain in machine.yaml'
    ))]  # fmt: skip

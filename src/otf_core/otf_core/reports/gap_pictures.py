# SPDX-License-Identifier: Apache-2.0
"""What the pictures of the gap report share: states of the residual, bars of groups, keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.place.groupings import Grouping
from otf_core.diagnosis.place.groups import partition
from otf_core.diagnosis.place.views import RunView
from otf_core.diagnosis.result import Diagnosis
from otf_core.reports.drawing.bars import LETTER, Bar, bars
from otf_core.reports.section import Picture

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """Residuals of all runs without or with the causes, and the class they are drawn in."""

    label: str
    kind: str
    residuals: list[Array]


def states(diagnosis: Diagnosis) -> list[State]:
    """Without and, if there are causes, with them."""
    views, causes = diagnosis.shown.views, bool(diagnosis.causes)
    named = 'cause' if len(diagnosis.causes) == 1 else 'causes'
    label = f'without the {named}' if causes else 'residual'
    found = [State(label, 'before', [v.residual_before for v in views])]
    if causes:
        found.append(State(f'with the {named}', 'after', [v.residual_after for v in views]))
    return found


def key(diagnosis: Diagnosis, *, stroke: bool = False) -> str:
    """Key of the states and of the noise, as markup; ``stroke``: as bars show the noise."""
    noise = 'class="key stroke"' if stroke else _filled('noise')
    names = [(_filled(s.kind), s.label) for s in states(diagnosis)] + [(noise, 'noise expected')]
    spans = ''.join(f'<span><span {look}></span>{label}</span>' for look, label in names)
    return f'<p class="soft keys">{spans}</p>'


def _filled(kind: str) -> str:
    return f'class="key" style="background:var(--{kind})"'


def groups_side_by_side(diagnosis: Diagnosis, grouping: Grouping) -> Picture:
    """Bars of the groups of one grouping, without and with the causes at one scale."""
    views = diagnosis.shown.views
    rows = []
    for state in states(diagnosis):
        [groups] = partition(views, [grouping], state.residuals)
        rows.append([
            Bar(_shown_label(grouping, g.label), ((1e6 * g.rms, state.kind),),
                f'{1e6 * g.rms:.2f} µm', 1e6 * g.expected)
            for g in groups
        ])  # fmt: skip
    every = [bar for own in rows for bar in own]
    names = 12.0 + LETTER * max(len(bar.name) for bar in every)
    parts = tuple(
        bars(own, f'where it lies: {grouping.kind}, {state.label}', names=names,
             beside=every, heading=state.label)
        for state, own in zip(states(diagnosis), rows, strict=True)
    )  # fmt: skip
    kind = 'the axes that move' if grouping.kind == 'lines' else grouping.kind
    caption = f'Root mean square of the residual by {kind}; stroke: what noise leaves.'
    return Picture(parts, caption, columns=2, key=key(diagnosis, stroke=True))


def _shown_label(grouping: Grouping, label: str) -> str:
    """A label with what it is of, where it does not say so."""
    if grouping.kind == 'lines':
        return f'line along {label}' if len(label) == 1 else f'diagonal {label}'
    return label


def group_bars(diagnosis: Diagnosis, parts: Sequence[Grouping], title: str) -> str:
    """Bars of groups: without the causes, below it with them; strokes for the noise expected."""
    views: Sequence[RunView] = diagnosis.shown.views
    drawn = [
        [group for own in partition(views, parts, state.residuals) for group in own]
        for state in states(diagnosis)
    ]
    rows = []
    for same in zip(*drawn, strict=True):
        for state, group in zip(states(diagnosis), same, strict=True):
            name = group.label if state.kind == 'before' else ''
            size = 1e6 * group.rms
            rows.append(Bar(name, ((size, state.kind),), f'{size:.2f} µm', 1e6 * group.expected))
    return bars(rows, title, names=158.0)

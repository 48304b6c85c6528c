# SPDX-License-Identifier: Apache-2.0
"""The table of a blind trial: who was named for whom, at what size, and how well sizes hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from otf_core.blind.outcome import CONFIDENT, NOISE, Outcome
from otf_core.blind.recovery import Recovery

SIZES = ((0.0, 0.3), (0.3, 0.7), (0.7, 2.0), (2.0, 20.0))
"""um; classes of the size in the residual."""
GAP_TOLERANCE = 0.2
SMALL_GAP_UM = 0.3
CLOSE = (2.0, 3.0)
"""Standard uncertainties."""
TOLD_APART = 10.0
"""Standard deviations; the fitted parameters alone make up some five."""
CONFIDENCE = ((0.0, 0.9), (0.9, 0.99), (0.99, 1.01))
"""Classes of the confidence stated."""


def _share(hits: int, of: int) -> str:
    return f'{hits} of {of}' + (f' ({100 * hits / of:.0f} %)' if of else '')


def _label(outcome: Outcome) -> str:
    """What the answer names, for the confusion matrix."""
    if outcome.result in ('right', 'listed') and len(outcome.truth) == 1:
        return 'right' if outcome.result == 'right' else 'listed'
    if outcome.result == 'failed':
        return 'failed'
    if outcome.named:
        return outcome.named[0]
    return {'unknown': '(unknown)', 'none': '(none)'}.get(outcome.verdict, '(noise)')


def confusion(outcomes: Sequence[Outcome]) -> list[str]:
    """Confusion matrix as lines of text: hidden effect, answers with their numbers."""
    single = [o for o in outcomes if len(o.truth) < 2]
    lines = []
    for hidden in sorted({o.truth for o in single}):
        for seen in (True, False):
            rows = [o for o in single if o.truth == hidden and all(o.visible) == seen]
            if not rows or (not hidden and not seen):
                continue
            answers = Counter(_label(o) for o in rows)
            words = ', '.join(f'{n} {name}' for name, n in answers.most_common())
            name = hidden[0] if hidden else 'none'
            name += '' if seen else ' (invisible)'
            hits = sum(o.is_right for o in rows)
            lines.append(f'{name:38s} {_share(hits, len(rows)):16s} {words}')
    return lines


def by_size(outcomes: Sequence[Outcome]) -> list[str]:
    """Share named rightly in classes of size, for single visible effects."""
    lines = []
    for low, high in SIZES:
        rows = [
            o
            for o in outcomes
            if len(o.truth) == 1 and o.visible[0] and o.kind in ('one', 'places')
            and o.truth[0] not in NOISE and low <= o.size_um[0] < high
        ]  # fmt: skip
        if rows:
            share = _share(sum(o.is_right for o in rows), len(rows))
            lines.append(f'{low:4.1f} um to {high:4.1f} um   {share}')
    return lines


def _count(outcomes: Iterable[Outcome], *results: str) -> int:
    return sum(o.result in results for o in outcomes)


def _line(name: str, hits: int, of: int) -> str:
    return f'{name:35s}{_share(hits, of)}'


def _counted(name: str, outcomes: Sequence[Outcome], *results: str) -> str:
    return _line(name, _count(outcomes, *results), len(outcomes))


def _right(name: str, outcomes: Sequence[Outcome]) -> str:
    return _line(name, sum(o.is_right for o in outcomes), len(outcomes))


def _needless(outcomes: Sequence[Outcome]) -> str:
    hits = sum(bool(o.extra) for o in outcomes)
    return _line('  with a needless cause besides', hits, len(outcomes))


def summary(outcomes: Sequence[Outcome]) -> list[str]:
    """The criteria, one line each."""
    names = ('none', 'one', 'two', 'unknown', 'places')
    kinds = {k: [o for o in outcomes if o.kind == k] for k in names}
    single = [o for o in (*kinds['one'], *kinds['places']) if o.visible[0]]
    hidden = [o for o in kinds['one'] if not o.visible[0]]
    places = [o for o in kinds['places'] if o.visible[0]]
    unknown = [o for o in kinds['unknown'] if all(o.visible)]
    parts = [(f, v) for o in kinds['two'] for f, v in zip(o.found, o.visible, strict=True)]
    found = [f for f, v in parts if v]
    return [
        _counted('failed', outcomes, 'failed'),
        _counted('no effect: false alarms', kinds['none'], 'false_alarm'),
        _right('one effect: named rightly', single),
        _counted('  of these in the list of another', single, 'listed'),
        _counted('  wrongly named', single, 'wrong', 'second'),
        _counted('  missed', single, 'unseen'),
        _counted('  called unknown', single, 'called_unknown'),
        _needless([o for o in single if o.is_right]),
        _line('two effects: visible parts found', sum(found), len(found)),
        _needless(kinds['two']),
        _counted('unknown effects: called unknown', unknown, 'unknown'),
        _counted('  given a name', unknown, 'forced'),
        _counted('invisible: listed as not visible', hidden, 'not_visible', 'right', 'listed'),
        _counted('  blamed on another', hidden, 'wrong', 'second'),
        _right('two places: effect named rightly', places),
    ]


def sizes(recovered: Sequence[Recovery]) -> list[str]:
    """How well gaps, parameters and intervals hold."""
    deviations = np.abs([d for r in recovered for d in r.deviations])
    large = [r for r in recovered if r.true_gap_um > SMALL_GAP_UM]
    near = sum(abs(r.gap_um / r.true_gap_um - 1.0) <= GAP_TOLERANCE for r in large)
    lines = [_line(f'gap within {100 * GAP_TOLERANCE:.0f} % of the truth', near, len(large))]
    for k in CLOSE:
        hits = int(np.sum(deviations < k))
        lines.append(_line(f'parameters within {k:.0f} u', hits, len(deviations)))
    named = [r for r in large if r.shrink_percent > 0]
    covered = sum(r.covered for r in named)
    lines.append(_line('shrink interval holds the truth', covered, len(named)))
    if named:
        difference = np.array([r.shrink_percent - r.achieved_percent for r in named])
        lines.append(
            f'predicted less achieved shrink   median {np.median(difference):+.0f} points, '
            f'95 % within {np.percentile(np.abs(difference), 95):.0f} points'
        )
    return lines


def details(outcomes: Sequence[Outcome]) -> list[str]:
    """Every cell that was not answered rightly."""
    lines = []
    for o in outcomes:
        if o.is_right and not o.extra:
            continue
        truth = ' + '.join(f'{t} {s:.2f} um' for t, s in zip(o.truth, o.size_um, strict=True))
        named = ', '.join(o.named) or '-'
        lines.append(f'{o.cell} {o.result:12s} {truth or "none":44s} -> {o.verdict}: {named}')
    return lines


def calibration(outcomes: Sequence[Outcome]) -> list[str]:
    """Share of the named causes that are hidden in the cell, by the confidence stated."""
    named = [
        (c, n not in o.extra) for o in outcomes for n, c in zip(o.named, o.confidence, strict=True)
    ]
    lines = []
    for low, high in CONFIDENCE:
        hits = [right for c, right in named if low <= c < high]
        if hits:
            stated = f'{low:.2f} to {min(high, 1.0):.2f}'
            lines.append(_line(stated, sum(hits), len(hits)))
    return lines


def first_place(alone: Sequence[Outcome]) -> list[str]:
    """What the first tracker place alone says of cells measured from two."""
    hidden = [o for o in alone if not o.visible[0]]
    seen = [o for o in alone if o.visible[0]]
    return [
        _counted('invisible: listed as not visible', hidden, 'not_visible'),
        _counted('  blamed on another', hidden, 'wrong', 'second'),
        _right('visible: named rightly', seen),
    ]


def report(
    outcomes: Sequence[Outcome],
    recovered: Sequence[Recovery],
    title: str,
    alone: Sequence[Outcome] = (),
) -> str:
    """The whole table as text."""
    parts: list[tuple[str, list[str]]] = [
        (title, summary(outcomes)),
        ('of two places only the first', first_place(alone) if alone else []),
        ('named rightly, by size in the residual', by_size(outcomes)),
        ('hidden effect, answered rightly, answers', confusion(outcomes)),
        ('causes named that are there, by stated confidence', calibration(outcomes)),
        ('sizes', sizes(recovered)),
        ('cells not answered rightly, or with a needless cause', details([*outcomes, *alone])),
    ]
    texts = ('\n'.join([head, *(f'  {x}' for x in lines)]) for head, lines in parts if lines)
    return '\n\n'.join(texts)


def leave_one_out_report(outcomes: Sequence[Outcome], recovered: Mapping[str, Recovery]) -> str:
    """The table of a trial in which every effect was taken out of the catalogue.

    A cause that leaves the trace of the hidden effect to within ``TOLD_APART`` is truly
    indistinguishable from it in these data.
    """
    lines, wrong, alike = [], 0, 0
    seen = [o for o in outcomes if all(o.visible)]
    for o in outcomes:
        pairs = list(zip(o.named, o.confidence, strict=True))
        words = ', '.join(f'{n} ({c:.2f})' for n, c in pairs) or '-'
        mark = '' if all(o.visible) else ' (invisible)'
        if all(o.visible) and any(c >= CONFIDENT for _, c in pairs):
            apart = recovered[o.cell].left_snr if o.cell in recovered else np.inf
            words += f'; told apart by {apart:.0f} standard deviations at best'
            wrong += apart > TOLD_APART
            alike += apart <= TOLD_APART
        truth = f'{o.truth[0]} {o.size_um[0]:.2f} um{mark}'
        lines.append(f'{o.cell} {truth:52s} -> {o.verdict}: {words}')
    head = [
        _line('blamed on another with confidence', wrong, len(seen)),
        _line('the same, indistinguishable', alike, len(seen)),
        _counted('called unknown', seen, 'unknown'),
    ]
    return '\n'.join([*head, '', *lines])


def score_to_dict(
    outcomes: Sequence[Outcome], recovered: Sequence[Recovery], alone: Sequence[Outcome] = ()
) -> dict[str, Any]:
    """Plain data of everything scored."""
    return {
        'schema': 'otf-blind-score/1',
        'outcomes': [{**vars(o), 'is_right': o.is_right} for o in outcomes],
        'first_place': [{**vars(o), 'is_right': o.is_right} for o in alone],
        'recovered': [{**vars(r), 'covered': r.covered} for r in recovered],
    }

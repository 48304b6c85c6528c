# SPDX-License-Identifier: Apache-2.0
"""Criteria of a blind trial: who was named for whom, at what size, and how well sizes hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

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


class Row(NamedTuple):
    """One criterion: in how many cells, causes or sizes of how many.

    Attributes
    ----------
    name : str
        Begins with a comma if it is about the cells of a row before.
    hits, of : int
    """

    name: str
    hits: int
    of: int

    @property
    def share(self) -> str:
        """As words, in percent too."""
        percent = f' ({100 * self.hits / self.of:.0f} %)' if self.of else ''
        return f'{self.hits} of {self.of}{percent}'


def _results(name: str, outcomes: Sequence[Outcome], *results: str) -> Row:
    return Row(name, sum(o.result in results for o in outcomes), len(outcomes))


def _right(name: str, outcomes: Sequence[Outcome]) -> Row:
    return Row(name, sum(o.is_right for o in outcomes), len(outcomes))


def _needless(outcomes: Sequence[Outcome]) -> Row:
    return Row(', a needless cause besides', sum(bool(o.extra) for o in outcomes), len(outcomes))


def _unknown(words: str, outcomes: Sequence[Outcome]) -> list[Row]:
    return [
        _results(f'{words}: called unknown', outcomes, 'unknown'),
        _results(', given a name', outcomes, 'forced'),
        _results(', nothing said', outcomes, 'unseen'),
    ]


def summary(outcomes: Sequence[Outcome]) -> list[Row]:
    """The criteria of a trial."""
    names = ('none', 'one', 'two', 'unknown', 'places')
    kinds = {k: [o for o in outcomes if o.kind == k] for k in names}
    single = [o for o in (*kinds['one'], *kinds['places']) if o.visible[0]]
    hidden = [o for o in (*kinds['one'], *kinds['places']) if not o.visible[0]]
    places = [o for o in kinds['places'] if o.visible[0]]
    unknown = [o for o in kinds['unknown'] if all(o.visible)]
    traceless = [o for o in kinds['unknown'] if not all(o.visible)]
    quiet = [o for o in outcomes if o.noise_as_specified]
    found = [
        f for o in kinds['two'] for f, v in zip(o.found, o.visible, strict=True) if v
    ]  # fmt: skip
    return [
        _results('command failed', outcomes, 'failed'),
        _results('nothing: false alarms', kinds['none'], 'false_alarm'),
        Row(f'noise as specified: {", ".join(NOISE)} named',
            sum(bool(NOISE & set(o.extra)) for o in quiet), len(quiet)),
        _right('one effect: named rightly', single),
        _results(', of these in the short list of the first cause', single, 'listed'),
        _results(', another named first', single, 'wrong', 'second'),
        _results(', nothing named', single, 'unseen'),
        _results(', called unknown', single, 'called_unknown'),
        _needless([o for o in single if o.is_right]),
        _right('one effect, two tracker places: named rightly', places),
        Row('two effects: visible parts named', sum(found), len(found)),
        _needless(kinds['two']),
        *_unknown(
            'not in the catalogue, a decoy exists', [o for o in unknown if o.has_decoy]
        ),
        *_unknown('not in the catalogue, no decoy', [o for o in unknown if not o.has_decoy]),
        Row('not in the catalogue, no trace: given a name',
            sum(bool(o.named) for o in traceless), len(traceless)),
        _results('no trace: listed as not visible', hidden, 'not_visible', 'right', 'listed'),
        _results(', blamed on another', hidden, 'wrong', 'second'),
    ]  # fmt: skip


def first_place(alone: Sequence[Outcome]) -> list[Row]:
    """What the first tracker place alone says of cells measured from two."""
    hidden = [o for o in alone if not o.visible[0]]
    return [
        _right('named rightly', [o for o in alone if o.visible[0]]),
        _results('no trace from there: listed as not visible', hidden, 'not_visible'),
        _results(', blamed on another', hidden, 'wrong', 'second'),
    ]


def by_size(outcomes: Sequence[Outcome]) -> list[Row]:
    """Share named rightly in classes of size, for single visible effects."""
    kept = [
        o for o in outcomes
        if o.kind in ('one', 'places') and len(o.truth) == 1 and o.visible[0]
        and o.truth[0] not in NOISE
    ]  # fmt: skip
    rows = [
        _right(f'{low:.1f} um to {high:.1f} um', [o for o in kept if low <= o.size_um[0] < high])
        for low, high in SIZES
    ]
    return [r for r in rows if r.of]


def _label(outcome: Outcome) -> str:
    """What the answer names, for the confusion matrix."""
    if outcome.result in ('right', 'listed') and len(outcome.truth) == 1:
        return 'right' if outcome.result == 'right' else 'listed'
    if outcome.result == 'failed':
        return 'failed'
    if outcome.named:
        return outcome.named[0]
    return {'unknown': '(unknown)', 'none': '(none)'}.get(outcome.verdict, '(noise)')


def confusion(outcomes: Sequence[Outcome]) -> list[tuple[Row, str]]:
    """Hidden effects, how often answered rightly, and what was answered how often."""
    single = [o for o in outcomes if len(o.truth) < 2]
    lines = []
    for hidden in sorted({o.truth for o in single}):
        for seen in (True, False):
            rows = [o for o in single if o.truth == hidden and all(o.visible) == seen]
            if not rows or (not hidden and not seen):
                continue
            answers = Counter(_label(o) for o in rows)
            name = (hidden[0] if hidden else 'nothing') + ('' if seen else ' (no trace)')
            words = ', '.join(f'{n} {label}' for label, n in answers.most_common())
            lines.append((_right(name, rows), words))
    return lines


def calibration(outcomes: Sequence[Outcome]) -> list[Row]:
    """Share of the named causes that are hidden in the cell, by the confidence stated."""
    named = [
        (c, n not in o.extra) for o in outcomes for n, c in zip(o.named, o.confidence, strict=True)
    ]
    rows = []
    for low, high in CONFIDENCE:
        hits = [there for c, there in named if low <= c < high]
        if hits:
            rows.append(Row(f'{low:.2f} to {min(high, 1.0):.2f}', sum(hits), len(hits)))
    return rows


def sizes(recovered: Sequence[Recovery]) -> list[Row]:
    """How well gaps, parameters and intervals hold."""
    deviations = np.abs([d for r in recovered for d in r.deviations])
    large = [r for r in recovered if r.true_gap_um > SMALL_GAP_UM]
    near = sum(abs(r.gap_um / r.true_gap_um - 1.0) <= GAP_TOLERANCE for r in large)
    named = [r for r in large if r.shrink_percent > 0]
    return [
        Row(f'gap within {100 * GAP_TOLERANCE:.0f} % of the truth', near, len(large)),
        *(Row(f'parameters within {k:.0f} u', int(np.sum(deviations < k)), len(deviations))
          for k in CLOSE),
        Row('95 % interval of the shrink holds the truth',
            sum(r.covered for r in named), len(named)),
    ]  # fmt: skip


def leave_one_out(outcomes: Sequence[Outcome], recovered: Mapping[str, Recovery]) -> list[Row]:
    """Criteria where every effect was taken out of the catalogue.

    A cause that leaves the trace of the hidden effect to within ``TOLD_APART`` is truly
    indistinguishable from it in these data.
    """
    seen = [o for o in outcomes if all(o.visible)]
    sure = [o for o in seen if any(c >= CONFIDENT for c in o.confidence)]
    apart = sum(told_apart(o, recovered) > TOLD_APART for o in sure)
    return [
        Row('blamed with confidence on another that can be told apart', apart, len(seen)),
        Row(', on one of the same trace', len(sure) - apart, len(seen)),
        _results(', called unknown', seen, 'unknown'),
    ]


def told_apart(outcome: Outcome, recovered: Mapping[str, Recovery]) -> float:
    """Standard deviations at which a perfect observer tells the answer from the truth."""
    return recovered[outcome.cell].left_snr if outcome.cell in recovered else float(np.inf)


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

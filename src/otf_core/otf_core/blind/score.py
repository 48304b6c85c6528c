# SPDX-License-Identifier: Apache-2.0
"""Criteria of a blind trial: who was named for whom, how sure, and how well sizes hold.

Intervals are those of Clopper and Pearson (Biometrika 26 (1934) 404): their ends are quantiles of
beta distributions, and they hold the true share in at least 95 % of all trials.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.special import betaincinv

from otf_core.blind.outcome import CONFIDENT, NOISE, Outcome
from otf_core.blind.recovery import Recovery

COVERED = 0.95
CLASSES = (0.0, 0.5, 0.9, 0.99, 1.0)
"""Limits of the classes of a stated confidence."""


class Row(NamedTuple):
    """One criterion: in how many cells, causes or sizes of how many.

    Attributes
    ----------
    name : str
        Begins with a comma if it is about the cells of a row before.
    """

    name: str
    hits: int
    of: int

    @property
    def share(self) -> str:
        """As words, in percent too."""
        percent = f' ({100 * self.hits / self.of:.0f} %)' if self.of else ''
        return f'{self.hits} of {self.of}{percent}'

    @property
    def interval(self) -> str:
        """95 % interval of the share, as words; empty where nothing was counted."""
        if not self.of:
            return ''
        low, high = binomial_interval(self.hits, self.of)
        return f'{100 * low:.0f} % to {100 * high:.0f} %'


def binomial_interval(hits: int, of: int) -> tuple[float, float]:
    """Interval of a share of which ``hits`` of ``of`` were seen."""
    tail = 0.5 * (1.0 - COVERED)
    low = float(betaincinv(hits, of - hits + 1, tail)) if hits else 0.0
    high = float(betaincinv(hits + 1, of - hits, 1.0 - tail)) if hits < of else 1.0
    return low, high


class ConfidenceClass(NamedTuple):
    """A class of stated confidences.

    Attributes
    ----------
    row : Row
        How many of the causes are there.
    mean : float
        Confidence stated for them.
    """

    row: Row
    mean: float


def reliability(said: Sequence[tuple[float, bool]]) -> list[ConfidenceClass]:
    """Share of the causes that are there, by the confidence stated for them."""
    classes = []
    for low, high in pairwise(CLASSES):
        own = [(c, there) for c, there in said if low <= c < high or c == high == 1.0]
        if own:
            name = f'{low:.2f} to {high:.2f}'
            row = Row(name, sum(there for _, there in own), len(own))
            classes.append(ConfidenceClass(row, sum(c for c, _ in own) / len(own)))
    return classes


def expected_calibration_error(classes: Sequence[ConfidenceClass]) -> float:
    """Mean distance of the stated confidence from the share that is there, over all causes."""
    count = sum(c.row.of for c in classes)
    off = sum(c.row.of * abs(c.mean - c.row.hits / c.row.of) for c in classes)
    return off / count if count else 0.0


GAP_TOLERANCE = 0.2
SIZE_TOLERANCE = 0.25
SMALL_GAP_UM = 0.3
CLOSE = (2.0, 3.0)
"""Standard uncertainties."""
TOLD_APART = 10.0
"""Standard deviations; the fitted parameters alone make up some five."""
THIRD, HALF = 1.0 / 3.0, 0.5
"""Shares of a gap that a cause in another form, and one of no catalogue, may leave."""


def _results(name: str, outcomes: Sequence[Outcome], *results: str) -> Row:
    return Row(name, sum(o.result in results for o in outcomes), len(outcomes))


def _right(name: str, outcomes: Sequence[Outcome]) -> Row:
    return Row(name, sum(o.is_right for o in outcomes), len(outcomes))


def _shrunk_below(name: str, outcomes: Sequence[Outcome], share: float) -> Row:
    """Right answers that leave less than a share of the gap."""
    shares = [o.gap_left for o in outcomes if o.is_right]
    return Row(name, sum(g is not None and g < share for g in shares), len(outcomes))


def _inputs(outcomes: Sequence[Outcome]) -> list[Row]:
    """Inputs named where the truth has no name and is a function of inputs."""
    judged = [o for o in outcomes if o.inputs_right is not None]
    return [
        Row(', with the right inputs', sum(bool(o.inputs_right) for o in judged), len(judged)),
        Row(', with these and others', sum(bool(o.inputs_among) for o in judged), len(judged)),
    ]


def summary(outcomes: Sequence[Outcome]) -> list[Row]:
    """The criteria of a trial, family by family, of cells whose causes leave a trace."""

    def of(*kinds: str) -> list[Outcome]:
        return [o for o in outcomes if o.kind in kinds and all(o.visible)]

    def named(words: str, *kinds: str) -> Row:
        return _right(f'{words}: named correctly', of(*kinds))

    def parts_of(kind: str) -> list[bool]:
        own = [o for o in outcomes if o.kind == kind]
        return [f for o in own for f, v in zip(o.found, o.visible, strict=True) if v]

    parts, both = parts_of('mixture'), parts_of('axes_two')
    small = [o for o in outcomes if o.kind == 'small']
    unknown, other = of('unknown'), of('long', 'places', 'signal')
    as_is = [o for o in outcomes if o.kind == 'as_is' and o.visible[0]]
    return [
        _results('command failed', outcomes, 'failed'),
        _results('nothing: no cause reported', of('none'), 'quiet'),
        _results('small causes alone: no other claimed', small, 'quiet'),
        named('one effect', 'one'),
        named('a faint or a very large one', 'faint', 'large'),
        named('a known cause in another form', 'departed'),
        _shrunk_below(', less than a third of the gap left', of('departed'), THIRD),
        named('a table that tilts', 'tilt'),
        Row('one on a machine of 2 m to 6 m, from two places, by a signal: named correctly',
            sum(o.is_right and o.follows is not False for o in other), len(other)),
        Row('two or three causes: visible ones named', sum(parts), len(parts)),
        _right('one cause amid small ones: named first', as_is),
        Row(', none claimed', sum(not o.sure_extra for o in as_is), len(as_is)),
        _results('no catalogue: called unknown', unknown, 'unknown'),
        _shrunk_below(', less than half of the gap left', unknown, HALF),
        _results('five axes, nothing: no cause reported', of('axes_none'), 'quiet'),
        named('five axes, one effect of a rotary axis', 'axes_one'),
        named('five axes, one of a linear axis', 'axes_linear'),
        Row('five axes, two causes: named', sum(both), len(both)),
    ]  # fmt: skip


def further_counts(outcomes: Sequence[Outcome]) -> list[Row]:
    """What else can be counted: needless causes, inputs, what leaves no trace."""
    noise = [o for o in outcomes if o.noise_as_specified]
    alone = [o for o in outcomes if o.kind in ('one', 'faint', 'places')]
    hidden = [o for o in alone if not all(o.visible)]
    unknown = [o for o in outcomes if o.kind == 'unknown' and all(o.visible)]
    right = [o for o in outcomes if o.is_right and len(o.truth) == 1]
    return [
        Row(f'noise as specified: {", ".join(NOISE)} named',
            sum(bool(NOISE & set(o.extra)) for o in noise), len(noise)),
        Row('one cause named correctly, and a needless one',
            sum(bool(o.extra) for o in right), len(right)),
        _results('no trace: listed as not visible', hidden, 'not_visible', 'right', 'listed'),
        _results(', attributed to another', hidden, 'wrong', 'second'),
        _results('no catalogue: given a name', unknown, 'forced'),
        _results(', nothing said', unknown, 'unseen'),
        *_inputs(unknown),
    ]  # fmt: skip


def first_place(alone: Sequence[Outcome]) -> list[Row]:
    """What the first tracker place alone says of cells measured from two."""
    hidden = [o for o in alone if not o.visible[0]]
    return [
        _right('named correctly', [o for o in alone if o.visible[0]]),
        _results('no trace from there: listed as not visible', hidden, 'not_visible'),
        _results(', attributed to another', hidden, 'wrong', 'second'),
    ]


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
    """Hidden effects, how often answered correctly, and what was answered how often."""
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


def stated_confidences(outcomes: Sequence[Outcome]) -> list[tuple[float, bool]]:
    """Confidence of every cause that is named, and whether it is hidden in the cell."""
    return [
        (c, n not in o.extra) for o in outcomes for n, c in zip(o.named, o.confidence, strict=True)
    ]


def sizes(recovered: Sequence[Recovery], outcomes: Sequence[Outcome]) -> list[Row]:
    """How well gaps, parameters, intervals and simulated residuals hold."""
    off = np.abs([o.simulated_off for o in outcomes if o.simulated_off is not None])
    stated = np.array([d for o in outcomes for d in o.stated_off])
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
        Row('simulated residual within 2 u of the truth', int(np.sum(off < CLOSE[0])), len(off)),
        Row(f'sizes of five-axis causes within {100 * SIZE_TOLERANCE:.0f} % of the truth',
            int(np.sum(np.abs(stated) < SIZE_TOLERANCE)), len(stated)),
    ]  # fmt: skip


def leave_one_out(outcomes: Sequence[Outcome], recovered: Mapping[str, Recovery]) -> list[Row]:
    """Criteria where every effect was taken out of the catalogue.

    A cause that leaves the trace of the hidden effect to within ``TOLD_APART`` is truly
    indistinguishable from it in these data.
    """
    seen = [o for o in outcomes if all(o.visible)]
    sure = [o for o in seen if any(c >= CONFIDENT for c in o.confidence)]
    apart = sum(distinguishability(o, recovered) > TOLD_APART for o in sure)
    return [
        _results('an effect taken out of the catalogue: called unknown', seen, 'unknown'),
        Row(
            ', attributed with confidence to another effect that is distinguishable',
            apart,
            len(seen),
        ),
    ]


def distinguishability(outcome: Outcome, recovered: Mapping[str, Recovery]) -> float:
    """Standard deviations at which a perfect observer tells the answer from the truth."""
    return recovered[outcome.cell].left_snr if outcome.cell in recovered else float(np.inf)


def score_to_dict(
    outcomes: Sequence[Outcome], recovered: Sequence[Recovery], alone: Sequence[Outcome] = ()
) -> dict[str, Any]:
    """Plain data of everything scored."""
    classes = reliability(stated_confidences(outcomes))
    return {
        'schema': 'otf-blind-score/3',
        'criteria': [
            {**r._asdict(), 'interval': r.interval}
            for r in (*summary(outcomes), *further_counts(outcomes))
        ],
        'reliability': [{**c.row._asdict(), 'stated': c.mean} for c in classes],
        'expected_calibration_error': expected_calibration_error(classes),
        'outcomes': [{**vars(o), 'is_right': o.is_right} for o in outcomes],
        'first_place': [{**vars(o), 'is_right': o.is_right} for o in alone],
        'recovered': [{**vars(r), 'covered': r.covered} for r in recovered],
    }

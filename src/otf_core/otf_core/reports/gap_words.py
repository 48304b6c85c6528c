# SPDX-License-Identifier: Apache-2.0
"""Words of the gap report: confidence, names of effects, what to measure next."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from otf_core.diagnosis.result import Diagnosis, NamedCause
from otf_core.effects import REGISTRY
from otf_core.model.expanded import COVERAGE_FACTOR
from otf_core.model.quantities import quantity
from otf_core.reports.quantities import listed

CONFIDENCE = (
    (0.99, 'practically certain'),
    (0.95, 'very likely'),
    (0.8, 'likely'),
    (0.5, 'more likely than not'),
    (0.0, 'doubtful'),
)
VERDICTS = {
    'none': 'no gap',
    'explained': 'explained',
    'partly_explained': 'partly explained',
    'unknown': 'cause unknown',
}
MOST_PARAMETERS = 8
"""Of longer lists the most significant ones are shown."""


def effect_name(effect: str) -> str:
    """Name of an effect in words."""
    return effect.replace('_', ' ')


def effect_cause(effect: str) -> str:
    """What causes an effect; empty for a name that is not in the catalogue."""
    known = REGISTRY.get(effect)
    return known.cause if known else ''


def effect_meaning(effect: str) -> tuple[str, str]:
    """Formula of an effect and what its parameters are; empty if it is not in the catalogue."""
    known = REGISTRY.get(effect)
    return (known.equation, known.coefficients) if known else ('', '')


def confidence_words(confidence: float) -> str:
    """Confidence in words and as a number."""
    word = next(word for least, word in CONFIDENCE if confidence >= least)
    number = '>\u00a099.9\u00a0%' if confidence > 0.999 else f'{100 * confidence:.3g}\u00a0%'
    return f'{word} ({number})'


def shown_parameters(cause: NamedCause) -> tuple[list[str], int, int]:
    """Estimated parameters worth showing; how many more are significant, and how many are not.

    Significant is what is larger than its expanded uncertainty.
    """

    def strength(name: str) -> float:
        u = cause.u[name]
        return abs(cause.parameters[name]) / u if u > 0 else math.inf

    estimated = [n for n in cause.parameters if n in cause.u]
    significant = [n for n in estimated if strength(n) > COVERAGE_FACTOR]
    kept = set(sorted(significant, key=strength, reverse=True)[:MOST_PARAMETERS])
    shown = [n for n in significant if n in kept]
    return shown, len(significant) - len(shown), len(estimated) - len(significant)


def left_out_words(more: int, weak: int) -> list[str]:
    """What is not listed of the parameters of a cause."""
    words = [f'{more} more significant ones in gap.json'] if more else []
    if weak:
        verb = 'is' if weak == 1 else 'are'
        words.append(f'{weak} further {verb} not significant (|value| < U), in gap.json')
    return words


def shape_words(cause: NamedCause) -> str:
    """Parameters that were chosen, not estimated; empty if there are none."""
    chosen = [
        f'{name} {quantity(value, None, cause.units.get(name, ""))}'
        for name, value in cause.parameters.items()
        if name not in cause.u
    ]
    return f'chosen: {", ".join(chosen)}' if chosen else ''


def looked_at(diagnosis: Diagnosis) -> list[str]:
    """What was looked for and how small an effect would have been seen; nothing of a cause."""
    if diagnosis.causes:
        return []
    hidden = [effect for effect, _ in diagnosis.not_visible]
    seen = {
        effect: size
        for effect, size in diagnosis.smallest_found_um.items()
        if effect not in hidden
    }
    if not seen:
        return []
    order = sorted(seen, key=seen.__getitem__)
    least, most = order[0], order[-1]
    sizes = [f'{seen[name]:.2f} um ({effect_name(name)})' for name in (least, most)]
    words = [
        f'Looked for: {len(seen) + len(hidden)} effects. {len(seen)} of them would have been '
        f'found from a root mean square displacement of {sizes[0]} to {sizes[1]} on.'
    ]
    if hidden:
        words.append(
            f'Not seen in these data, whatever their size: {listed(map(effect_name, hidden))}.'
        )
    return words


def _needs(effect: str) -> str:
    known = REGISTRY.get(effect)
    return known.needs if known else ''


def next_measurements(diagnosis: Diagnosis) -> list[str]:
    """What to measure next, plain text, most useful first."""
    wishes: list[tuple[str, str]] = []
    for cause in diagnosis.causes:
        rivals = cause.indistinguishable_from
        if rivals:
            others = ' or '.join(r.replace('_', ' ') for r in rivals)
            reason = f'to tell {cause.effect.replace("_", " ")} from {others}'
            wishes += [
                (n, reason) for n in dict.fromkeys(map(_needs, (cause.effect, *rivals))) if n
            ]
    if diagnosis.verdict in ('unknown', 'partly_explained'):
        wishes.append(
            (
                'the same path once more, also backwards and at a second feed, and from a second '
                'tracker place',
                'to see whether what stays unexplained belongs to time, travel or tracker',
            )
        )
    for effect, needs in diagnosis.not_visible:
        wishes.append((needs, effect.replace('_', ' ')))
    return _merged(wishes, {e.replace('_', ' ') for e, _ in diagnosis.not_visible})


def _merged(wishes: Iterable[tuple[str, str]], hidden: set[str]) -> list[str]:
    """One line for wishes that begin alike: what is wanted, details, what for."""
    grouped: dict[str, tuple[list[str], list[str]]] = {}
    for wish, reason in wishes:
        head, *rest = re.split(r'[,;:] ', wish, maxsplit=1)
        details, reasons = grouped.setdefault(head, ([], []))
        details += [r for r in rest if r not in details]
        reasons.append(reason)
    lines = []
    for head, (details, reasons) in grouped.items():
        own = [r for r in reasons if r not in hidden]
        unseen = [r for r in reasons if r in hidden]
        if unseen:
            own.append('to see ' + listed(unseen))
        detail = f' ({"; ".join(details)})' if details else ''
        lines.append(f'{head[:1].upper()}{head[1:]}{detail}: {"; ".join(dict.fromkeys(own))}.')
    return lines

# SPDX-License-Identifier: Apache-2.0
"""What answers are worth once the key is open: gap.json against what is hidden.

Right is: the hidden effect is the first cause, or in its list of at most ``SHORT_LIST`` that it
cannot be told from; of a cause in another form, any name that fits it; of several, every visible
one in any place. Of nothing: no cause, and not 'unknown'. Of a cause of no catalogue, or one that
was taken out: 'unknown'. What leaves next to nothing is right as not visible. A cause is foreign
if neither it nor its list is hidden. Read are the fields of the interface alone.

Intervals of shares are those of Clopper and Pearson (Biometrika 26 (1934) 404).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from blind.draw import LEFT_OUT, ROTARY, Entry, draw_cell, draw_names
from blind.effects import FORMS, PLAIN
from blind.nature import SIX
from scipy.special import betaincinv

SHORT_LIST = 4
VISIBLE_SNR, VISIBLE_UM = 6.0, 0.25
"""From here on an effect counts as visible: to a perfect observer, and in the residual."""
BENDS_UM = 0.1
"""Where smooth errors leave more between the nodes, naming that is not wrong."""
SURE = 0.9
"""Confidence from which a cause that is not there counts as claimed, where small ones are."""
SMALL_GAP_UM = 0.3
LOOSE = ('order', 'until')
"""Parameters that state the extent of a function, not its shape."""

Answer = Mapping[str, Any]


@dataclass(frozen=True)
class Outcome:
    """One cell, scored.

    Attributes
    ----------
    result : str
        right, listed, not visible, unknown or quiet count as right; else failed, wrong (another is
        named), unseen, half (some of several), called unknown, forced (a name where none fits),
        false alarm, silent (neither named nor said to be not visible).
    found, visible : tuple of bool
        Of what is hidden.
    stated : tuple of (name, confidence, bool)
        Causes, and whether each is there.
    gap : tuple of float, um
        As the answer has it, and in truth.
    left : float
        Share of the gap that is left on lines that were not fitted on.
    inputs : bool, optional
        Whether those of a cause of no catalogue are named.
    shrink : tuple of float, optional, %
        Stated interval, and what the stated formulas really take away.
    deviations : tuple of float
        Fitted less true parameters over their standard uncertainties.
    """

    cell: str
    kind: str
    hidden: str
    answer: str
    result: str
    found: tuple[bool, ...] = ()
    visible: tuple[bool, ...] = ()
    stated: tuple[tuple[str, float, bool], ...] = ()
    gap: tuple[float, float] = (0.0, 0.0)
    left: float = 1.0
    inputs: bool | None = None
    shrink: tuple[float, float, float] | None = None
    deviations: tuple[float, ...] = ()

    @property
    def right(self) -> bool:
        """Whether the answer counts as right."""
        return self.result in ('right', 'listed', 'not visible', 'unknown', 'quiet')

    @property
    def foreign(self) -> list[float]:
        """Confidences of the causes that are not there."""
        return [c for _, c, there in self.stated if not there]


def known_names(cause: Answer) -> set[str]:
    """Name of a cause and, if it is short, the list it cannot be told from."""
    others = cause['indistinguishable_from']
    return {cause['effect'], *(others if len(others) <= SHORT_LIST else ())}


def is_visible(part: Entry, kind: str) -> bool:
    """Whether an effect of the key leaves enough to be seen."""
    form = FORMS[part['form']]
    if form.noise:
        return True
    size = part['raw_um'] if form.is_wave else part['size_um']
    return part['snr'] >= VISIBLE_SNR and (kind in ROTARY or size >= VISIBLE_UM)


def judge(entry: Entry, answer: Answer, achieved: float | None = None) -> Outcome:
    """Score one answer; ``achieved``: see ``achieved_percent``."""
    hidden, kind = entry['hidden'], entry['kind']
    words = ', '.join(f'{p["form"]} {p["size_um"]:.2f} um' for p in hidden) or 'nothing'
    if 'failed' in answer:
        return Outcome(entry['cell'], kind, words, answer['failed'], 'failed')
    tolerated = {'tracker_noise'} if entry['heavy_tails'] else set()
    tolerated |= {'table_resolution'} if entry['bends_um'] > BENDS_UM else set()
    names = [set(p['names']) for p in hidden]
    every = set().union(*names)
    causes = [c for c in answer['causes'] if c['effect'] not in tolerated - every]
    said = [known_names(c) for c in causes]
    named = set().union(*said)
    unnamed, gap = answer.get('unnamed') or {}, answer['gap']
    held_out, low_high = unnamed or gap, gap['shrink_interval_percent']
    before = held_out['before_um']
    listed = ', '.join(f'{c["effect"]} {c["confidence"]:.2f}' for c in causes)
    return Outcome(
        entry['cell'],
        kind,
        words,
        f'{answer["verdict"]}: {listed}',
        _result(entry, answer, causes),
        found=tuple(bool(n & named) for n in names),
        visible=tuple(is_visible(p, kind) for p in hidden),
        stated=tuple((c['effect'], float(c['confidence']), bool(s & every))
                     for c, s in zip(causes, said, strict=True)),
        gap=(gap['before_um'],
             max(0.0, entry['measured_um'] ** 2 - entry['simulated_um'] ** 2) ** 0.5),
        left=held_out['after_um'] / before if before > 0.0 else 1.0,
        inputs=_inputs(hidden, unnamed) if kind == 'unknown' else None,
        shrink=None if achieved is None else (*low_high, achieved),
        deviations=tuple(d for p in hidden for c in causes for d in _deviations(p, c)),
    )  # fmt: skip


def _result(entry: Entry, answer: Answer, causes: Sequence[Answer]) -> str:
    """How the causes that are named, with their lists, answer what is hidden."""
    kind, unknown = entry['kind'], answer['verdict'] == 'unknown'
    names, said = [set(p['names']) for p in entry['hidden']], [known_names(c) for c in causes]
    if kind in ('unknown', LEFT_OUT):
        return 'forced' if said else 'unknown' if unknown else 'unseen'
    if kind == 'small':
        every = set().union(*names)
        sure = [c['confidence'] >= SURE for c in causes if not known_names(c) & every]
        return 'false alarm' if any(sure) else 'quiet'
    if not names:
        return 'false alarm' if said or unknown else 'quiet'
    visible = [n for n, p in zip(names, entry['hidden'], strict=True) if is_visible(p, kind)]
    if len(names) > 1 and kind != 'amid small':
        hits = sum(any(n & s for s in said) for n in visible)
        return (
            'right' if hits == len(visible) else 'half' if hits else 'wrong' if said else 'unseen'
        )
    if said:
        first = causes[0]['effect'] in names[0]
        return 'right' if first else 'listed' if names[0] & said[0] else 'wrong'
    if unknown:
        return 'called unknown'
    if visible:
        return 'unseen'
    return 'not visible' if names[0] & {e['effect'] for e in answer['not_visible']} else 'silent'


def _inputs(hidden: Sequence[Entry], unnamed: Answer) -> bool | None:
    """Whether an answer names the inputs of a cause of no catalogue, up to two, and no others."""
    form, named = FORMS[hidden[0]['form']], set(unnamed.get('depends_on', ()))
    if not form.groups:
        return None
    served = sum(bool(set(g) & named) for g in form.groups)
    known = {n for g in form.groups for n in g} | set(form.besides)
    return served >= min(len(form.groups), 2) and named <= known


def true_parameters(part: Entry) -> dict[str, float]:
    """Parameters of a hidden effect as the interface names them; none where it has no formula."""
    p, name = part['parameters'], part['form']
    if name in PLAIN:
        return dict(p)
    if name in ('turning_play', 'turning_linear_play'):  # what is pushed stays behind
        return {f'B_{SIX[int(p["axis"])]}': -p['size']}
    if name in ('turning_late', 'turning_linear_late'):
        return {f'T_{SIX[int(p["axis"])]}': p['size']}
    return {}


def _deviations(part: Entry, cause: Answer) -> list[float]:
    """Of all parameters of a cause that is hidden by the same formula with the same shape."""
    true, fitted = true_parameters(part), cause['parameters']
    if cause['effect'] not in part['names'] or cause.get('form') == 'free' or not true:
        return []
    shape = [n for n in FORMS[part['form']].shape if n in true and n not in LOOSE]
    alike = [n in fitted and abs(fitted[n] - true[n]) <= 0.02 * abs(true[n]) for n in shape]
    if not all(alike) or 'tau' in shape:
        return []
    only = set(true) if part['form'] not in PLAIN else set(cause['u'])
    return [(fitted[n] - true.get(n, 0.0)) / u for n, u in cause['u'].items()
            if u > 0 and n in only and n not in shape]  # fmt: skip


def can_be_achieved(entry: Entry, answer: Answer) -> bool:
    """Whether what an answer takes away can be worked out: causes stated by formulas."""
    if entry['kind'] in ROTARY or not entry['hidden'] or not answer.get('causes'):
        return False
    moving = all(not FORMS[p['form']].noise for p in entry['hidden'])
    formulas = [c.get('form') != 'free' and c['effect'] in PLAIN and not PLAIN[c['effect']].noise
                for c in answer['causes']]  # fmt: skip
    return moving and all(formulas)


def achieved_percent(seed: int, entry: Entry, causes: Sequence[Answer]) -> float | None:
    """Share of what is hidden that the stated formulas with the stated parameters take away, %.

    None where a formula has a parameter more than it is known by here.
    """
    rng = np.random.default_rng([seed, *entry['cell'].encode()])
    names = draw_names(entry['kind'], entry['turn'], rng)
    cell = draw_cell(entry['kind'], rng, names)
    true = cell.displaced((FORMS[p['form']], p['parameters']) for p in entry['hidden'])
    try:
        said = cell.displaced((PLAIN[c['effect']], c['parameters']) for c in causes)
    except KeyError:
        return None
    rest = cell.observer.left([t - s for t, s in zip(true, said, strict=True)])[0]
    return 100.0 * max(0.0, 1.0 - rest / cell.observer.left(true)[0])


Row = tuple[str, int, int]
"""What is counted, in how many, of how many."""


def interval(hits: int, of: int) -> tuple[float, float]:
    """95 % interval of a share."""
    low = float(betaincinv(hits, of - hits + 1, 0.025)) if hits else 0.0
    return low, float(betaincinv(hits + 1, of - hits, 0.975)) if hits < of else 1.0


def _count(name: str, flags: Iterable[bool]) -> Row:
    counted = list(flags)
    return name, sum(map(bool, counted)), len(counted)


FAMILIES = (
    ('nothing: no cause reported', ('none',)),
    ('small causes alone: no other claimed', ('small',)),
    ('one effect: named, or said to be not visible', ('one',)),
    ('a faint or a very large one', ('faint', 'large')),
    ('a known cause in another form', ('other form',)),
    ('a table that tilts', ('tilt',)),
    ('on a machine of 2 m to 6 m, from two places, by a signal', ('long', 'places', 'signal')),
    ('one cause amid small ones: named first', ('amid small',)),
    ('no catalogue: called unknown', ('unknown',)),
    ('an effect taken out of the catalogue: called unknown', (LEFT_OUT,)),
    ('rotary axes, nothing: no cause reported', ('rotary none',)),
    ('rotary axes, one fault of a rotary axis', ('rotary one',)),
    ('rotary axes, one of a linear axis', ('rotary linear',)),
)


def rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """The criteria of a trial."""
    good = [o for o in outcomes if o.result != 'failed']

    def of(*kinds: str) -> list[Outcome]:
        return [o for o in outcomes if o.kind in kinds]

    def parts(kind: str) -> list[bool]:
        return [f for o in of(kind) for f, v in zip(o.found or (False,), o.visible or (True,),
                                                    strict=True) if v]  # fmt: skip

    table = [_count('command failed', (o.result == 'failed' for o in outcomes))]
    table += [_count(words, (o.right for o in of(*kinds))) for words, kinds in FAMILIES]
    stated = [s for o in good for s in o.stated]
    hidden = [f for o in good for f, v in zip(o.found, o.visible, strict=True) if v
              and o.kind not in ('unknown', 'small', 'amid small', LEFT_OUT)]  # fmt: skip
    large = [o.gap for o in good if o.gap[1] > SMALL_GAP_UM]
    off = np.abs([d for o in good for d in o.deviations])
    shrinks = [o.shrink for o in good if o.shrink]
    forms = [o for o in of('other form', 'tilt') if o.right]
    return [
        *table,
        _count('two or three causes: visible ones named', parts('mixture')),
        _count('rotary axes, two faults: named', parts('rotary two')),
        _count('visible causes missing', (not f for f in hidden)),
        _count('right only as indistinguishable from the first',
               (o.result == 'listed' for o in good if o.right)),
        _count('cells with a foreign cause', (bool(o.foreign) for o in good)),
        _count('cells with one of a confidence above 0.5', (max(o.foreign, default=0.0) > 0.5
                                                            for o in good)),
        *(_count(f'causes with a confidence of {low} to {high}: there',
                 (t for _, c, t in stated if low <= c < high or c == high == 1.0))
          for low, high in ((0.0, 0.5), (0.5, 0.9), (0.9, 1.0))),
        _count('other form, named: less than a third of the gap left',
               (o.left < 1.0 / 3.0 for o in forms)),
        _count('no catalogue, called unknown: less than half of the gap left',
               (o.left < 0.5 for o in of('unknown') if o.right)),
        _count('no catalogue: its inputs named', (o.inputs for o in of('unknown')
                                                  if o.inputs is not None)),
        _count('gap within 20 % of the truth', (abs(a / b - 1.0) <= 0.2 for a, b in large)),
        *(_count(f'parameters within {k} u', off < k) for k in (2, 3)),
        _count('interval of the shrink holds the truth',
               (low - 1e-9 <= true <= high + 1e-9 for low, high, true in shrinks)),
    ]  # fmt: skip


def as_markdown(table: Sequence[Row]) -> str:
    """Rows that something was counted for, as a table."""
    lines = ['| what | cells or causes | 95 % interval |', '|---|---|---|']
    for name, hits, of in table:
        if of:
            low, high = interval(hits, of)
            lines.append(f'| {name} | {hits} of {of} ({100 * hits / of:.0f} %) '
                         f'| {100 * low:.0f} % to {100 * high:.0f} % |')  # fmt: skip
    return '\n'.join(lines)


def misses(outcomes: Sequence[Outcome]) -> str:
    """Every cell that is not right, or that names a foreign cause."""
    lines = [f'{o.cell} {o.kind}: {o.result}; hidden: {o.hidden}; answer: {o.answer}'
             for o in outcomes if not o.right or o.foreign]  # fmt: skip
    return '\n'.join(lines)

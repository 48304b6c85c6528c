# SPDX-License-Identifier: Apache-2.0
"""What an answer is worth once the key is open, cell by cell.

Right is: the true effect is the first cause, or named as indistinguishable from it in a short
list; of a cause in another form, any name that fits it. tracker_noise is a cause like any other;
it may be named besides where the noise has heavy tails. An effect that leaves next to nothing in
the residual is answered correctly by listing it as not visible and naming no other cause. Of a
cause of no catalogue, 'unknown' is right, and the inputs that the answer names are compared with
those of the truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from otf_core.blind.depends import named_rightly
from otf_core.effects import EVERY, BelongsTo, names_of
from otf_core.model.declared_signals import HEAD

NOISE = names_of(BelongsTo.NOISE)
BENDS = names_of(BelongsTo.TABLES)
SHORT_LIST = 4
"""Effects a cause may be said to be indistinguishable from."""
VISIBLE_SNR = 6.0
VISIBLE_UM = 0.25
"""From here on an effect counts as visible: to a perfect observer, and in the residual."""
BENDS_UM = 0.1
"""um; where smooth tables leave more between the nodes, naming that is no error."""
CONFIDENT = 0.5
SURE = 0.9
"""Confidence from which a cause that is not there counts as claimed."""

RIGHT = ('right', 'listed', 'quiet', 'not_visible', 'unknown')
"""Outcomes that count as right."""


@dataclass(frozen=True)
class Outcome:
    """One cell, scored.

    Attributes
    ----------
    truth : tuple of str
        Names of the hidden effects.
    size_um : tuple of float
        What each leaves in the residual.
    named : tuple of str
        Causes of the answer that could be wrong, first the first.
    result : str
        right, listed (in the short list of the first cause), second (named, but not first),
        wrong (another is named), unseen (none named), called_unknown; quiet or false_alarm
        without effect; unknown, forced (a name given) or unseen for one out of the catalogue;
        not_visible, silent (neither named nor listed) or wrong for an invisible one.
    found : tuple of bool
        Which parts are named anywhere.
    extra : tuple of str
        Named, but neither hidden nor indistinguishable from what is.
    sure_extra : tuple of str
        Those of them that are claimed, with a confidence of ``SURE`` or more.
    confidence : tuple of float
        Of the causes in ``named``.
    noise_as_specified : bool
        Whether naming ``tracker_noise`` is false.
    gap_left : float, optional
        Share of the gap that the causes, or the one without a name, leave on legs that they were
        not fitted on.
    inputs : tuple of str
        That the answer names for a cause without a name.
    inputs_right, inputs_among : bool, optional
        Whether these are those of the truth; whether those of the truth are among them; not
        where the answer is not 'unknown'. None where the truth has a name or no such inputs.
    follows : bool, optional
        Whether the signal that the truth follows is named; None where it follows none.
    simulated_off : float, optional
        Residual of the simulation as the answer has it less that of the truth without causes,
        over its stated standard uncertainty.
    stated_off : tuple of float
        Sizes stated for causes of machines with rotary axes less the true ones, in shares of them.
    """

    cell: str
    kind: str
    truth: tuple[str, ...]
    size_um: tuple[float, ...]
    visible: tuple[bool, ...]
    named: tuple[str, ...]
    verdict: str
    result: str
    found: tuple[bool, ...]
    extra: tuple[str, ...]
    sure_extra: tuple[str, ...] = ()
    confidence: tuple[float, ...] = ()
    noise_as_specified: bool = True
    gap_left: float | None = None
    inputs: tuple[str, ...] = ()
    inputs_right: bool | None = None
    inputs_among: bool | None = None
    follows: bool | None = None
    simulated_off: float | None = None
    stated_off: tuple[float, ...] = ()

    @property
    def is_right(self) -> bool:
        """Whether the answer counts as right."""
        return self.result in RIGHT


def is_visible(part: Mapping[str, Any]) -> bool:
    """Return whether an effect of the key leaves enough to be seen.

    Of machines with rotary axes an observer judges alone: gears leave next to nothing in means.
    """
    if part['effect'] in NOISE:
        return True
    if 'stated' in part:
        return bool(part['snr'] >= VISIBLE_SNR)
    blurred = any(EVERY[name].wave is not None for name in part['names'])
    size = max(part['size_um'], part['raw_um'] if blurred else 0.0)
    return bool(part['snr'] >= VISIBLE_SNR and size >= VISIBLE_UM)


def known_names(cause: Mapping[str, Any]) -> tuple[str, ...]:
    """Name of a cause and, if it is short, the list it cannot be told from."""
    others = tuple(cause['indistinguishable_from'])
    return (cause['effect'], *(others if len(others) <= SHORT_LIST else ()))


Causes = Sequence[Mapping[str, Any]]


def _one(right: set[str], causes: Causes, answer: Mapping[str, Any]) -> str:
    if not causes:
        return 'called_unknown' if answer['verdict'] == 'unknown' else 'unseen'
    if causes[0]['effect'] in right:
        return 'right'
    if right & set(known_names(causes[0])):
        return 'listed'
    return 'second' if any(right & set(known_names(c)) for c in causes) else 'wrong'


def _invisible(right: set[str], causes: Causes, answer: Mapping[str, Any]) -> str:
    if causes:
        return _one(right, causes, answer)
    if answer['verdict'] == 'unknown':
        return 'called_unknown'
    listed = {e['effect'] for e in answer['not_visible']}
    return 'not_visible' if right & listed else 'silent'


def _result(
    parts: Sequence[Mapping[str, Any]],
    causes: Causes,
    answer: Mapping[str, Any],
    exclude: Sequence[str],
    entry: Mapping[str, Any],
) -> str:
    bends_um = entry['bends_um']
    if entry['kind'] == 'small':
        return 'false_alarm' if _sure(_foreign(causes, parts)) else 'quiet'
    if entry['kind'] == 'as_is':
        return _one(set(parts[0]['names']), causes, answer)
    if not parts:
        alarm = causes or (answer['verdict'] == 'unknown' and bends_um <= BENDS_UM)
        return 'false_alarm' if alarm else 'quiet'
    right = [set(p['names']) for p in parts]
    if exclude or not right[0]:
        if causes:
            return 'forced'
        return 'unknown' if answer['verdict'] == 'unknown' else 'unseen'
    if len(parts) > 1:
        everything = {n for c in causes for n in known_names(c)}
        hits = sum(bool(r & everything) for r in right)
        if hits == len(parts):
            return 'right'
        return 'half' if hits else ('wrong' if causes else 'unseen')
    if not is_visible(parts[0]):
        return _invisible(right[0], causes, answer)
    return _one(right[0], causes, answer)


def _foreign(causes: Causes, parts: Sequence[Mapping[str, Any]]) -> Causes:
    """Causes that are neither hidden nor indistinguishable from what is."""
    allowed = {n for p in parts for n in p['names']}
    return [c for c in causes if not allowed & set(known_names(c))]


def _sure(causes: Causes) -> Causes:
    return [c for c in causes if c.get('confidence', 0.0) >= SURE]


def _remaining_share(answer: Mapping[str, Any]) -> float | None:
    """Share of the gap that is left on legs that were not fitted on; None without a gap."""
    gap = answer.get('unnamed') or answer.get('gap') or {}
    before = float(gap.get('before_um', 0.0))
    return float(gap['after_um']) / before if before > 0.0 else None


def _inputs(
    parts: Sequence[Mapping[str, Any]], answer: Mapping[str, Any], exclude: Sequence[str]
) -> dict[str, Any]:
    """Inputs that an answer names for a truth without a name, and whether they are its own."""
    groups = [g for p in parts for g in p['depends']['groups']]
    if not groups or not (exclude or all(not p['names'] for p in parts)):
        return {}
    unnamed = answer.get('unnamed') if answer.get('verdict') == 'unknown' else None
    named = tuple((unnamed or {}).get('depends_on', ()))
    besides = [n for p in parts for n in p['depends']['besides']]
    return {
        'inputs': named,
        'inputs_right': named_rightly(named, groups, *besides),
        'inputs_among': named_rightly(named, groups, *named),
    }


def _follows(parts: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]) -> bool | None:
    """Whether the signals of the truth are inputs of a cause, named or not."""
    groups = [g for p in parts for g in p['depends']['groups']]
    signals = {n for g in groups for n in g if n.startswith(HEAD)}
    if not signals:
        return None
    said = set((answer.get('unnamed') or {}).get('depends_on', ()))
    for cause in answer.get('causes', ()):
        said |= {n for c in cause.get('curves', ()) for n in (c['input'], *c['held'])}
    return signals <= {n.partition('@')[0] for n in said}


def _simulated_off(entry: Mapping[str, Any], answer: Mapping[str, Any]) -> float | None:
    """How far the simulated residual is from that of the truth, in standard uncertainties."""
    gap = answer.get('gap') or {}
    if not gap.get('simulated_u_um') or entry['simulated_um'] is None:
        return None
    return float((gap['simulated_um'] - entry['simulated_um']) / gap['simulated_u_um'])


def _stated_off(parts: Causes, causes: Causes) -> tuple[float, ...]:
    """Deviations of the sizes stated for causes that are there, as shares of the true ones."""
    shares = []
    for part in parts:
        true = part.get('stated', {})
        for cause in causes:
            said = [s for s in cause.get('sizes', ()) if s['unit'] == true.get('unit')]
            own = [s for s in said if any(f'of {a}' in s['of'] for a in part['axes'])] or said
            if cause['effect'] == part['effect'] and own:
                largest = max(abs(s['value']) for s in own)
                shares.append(largest / true['value'] - 1.0)
    return tuple(shares)


def outcome(
    entry: Mapping[str, Any],
    answer: Mapping[str, Any],
    exclude: Sequence[str] = (),
    *,
    first_place: bool = False,
) -> Outcome:
    """Score one answer.

    Parameters
    ----------
    entry : mapping
        Of the key.
    answer : mapping
        gap.json.
    exclude : sequence of str
        Effects that were taken out of the catalogue.
    first_place : bool
        Only the first of several tracker places was asked about.
    """
    parts = entry['first_place_only' if first_place else 'parts']
    truth = tuple(p['effect'] for p in parts)
    besides = set(NOISE) if entry['heavy_tails'] else set()
    if entry['bends_um'] > BENDS_UM:
        besides |= BENDS
    causes = [c for c in answer.get('causes', ()) if c['effect'] not in besides - set(truth)]
    right = [set(p['names']) for p in parts]
    everything = {n for c in causes for n in known_names(c)}
    extra = _foreign(causes, parts)
    failed = 'failed' in answer
    return Outcome(
        cell=entry['cell'],
        kind=entry['kind'],
        truth=truth,
        size_um=tuple(p['size_um'] for p in parts),
        visible=tuple(is_visible(p) for p in parts),
        named=tuple(c['effect'] for c in causes),
        verdict='failed' if failed else answer['verdict'],
        result='failed' if failed else _result(parts, causes, answer, exclude, entry),
        found=tuple(bool(r & everything) for r in right),
        extra=tuple(c['effect'] for c in extra),
        sure_extra=tuple(c['effect'] for c in _sure(extra)),
        confidence=tuple(float(c.get('confidence', 0.0)) for c in causes),
        noise_as_specified=not entry['heavy_tails'] and not NOISE & set(truth),
        gap_left=_remaining_share(answer),
        follows=_follows(parts, answer),
        simulated_off=None if first_place else _simulated_off(entry, answer),
        stated_off=_stated_off(parts, causes),
        **_inputs(parts, answer, exclude),
    )

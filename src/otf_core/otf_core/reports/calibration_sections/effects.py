# SPDX-License-Identifier: Apache-2.0
"""What was found and done about effects; those that were taken off before solving."""

from __future__ import annotations

from otf_core.effects.stated_effect import FOUND, effects_to_list, format_effects
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.section import Section, Table


def section(facts: Facts) -> Section | None:
    """Return the section; None where nobody asked for effects."""
    stated, sentence = facts.result.effects, facts.result.effects_sentence
    said = (sentence,) if sentence else ()
    if not stated:
        return Section('effects', 'Effects', said, text=(*said, '')) if said else None
    rows = []
    for one in stated:
        how = 'found by a diagnosis' if one.how == FOUND else 'named in a file'
        for name, value in one.parameters.items():
            u = one.u.get(name)
            known = 'as given' if u is None else f'{u:.3g}'
            unit = one.units.get(name, '')
            rows.append((one.effect.replace('_', ' '), how, name, f'{value:.5g}', known, unit))
    words = (
        *said,
        'These effects were taken off the runs first, so the tables do not hold them. Without '
        'them the tables are in the folder plain beside this report.',
    )
    head = ('Effect', 'How', 'Parameter', 'Value', 'u, k = 1', 'Unit (SI)')
    table = Table(head, tuple(rows), numbers=(3, 4))
    data = {'effects': effects_to_list(stated)}
    return Section('effects', 'Effects taken off', words, data, (table,),
                   (*said, format_effects(stated), ''))  # fmt: skip

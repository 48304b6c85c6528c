# SPDX-License-Identifier: Apache-2.0
"""Forward and backward travel, and figures after the fashion of ISO 230-2 derived from them."""

from __future__ import annotations

import numpy as np

from otf_core.reports.calibration_facts import Facts
from otf_core.reports.quantities import micro
from otf_core.reports.reversal import backlash_words, format_reversal
from otf_core.reports.section import Section, Table

DERIVED = (
    'Derived from continuous travel, not an ISO 230-2 test: there are no targets approached at '
    'standstill and no five repetitions, so A and R, which need the repeatability, are not given.'
)


def section(facts: Facts) -> Section:
    """Return the section."""
    reversal = facts.result.reversal
    text = (format_reversal(reversal), '')
    if not facts.both_ways:
        said = (
            f'Reversal model: {reversal.model}. The data do not tell forward from backward '
            f'travel, so no figures after ISO 230-2 can be derived.',
        )
        return Section('reversal', 'Forward and backward', said,
                       {'model': reversal.model}, text=text)  # fmt: skip
    rows: list[tuple[str, ...]] = []
    data = {}
    for axis in facts.machine.axis_names:
        name = f'E{axis}{axis}'
        table, mean = reversal.motions[name], facts.tables.motions[name].value
        if not table.identifiable or not facts.tables.motions[name].identifiable:
            rows.append((axis, 'not known', '', '', '', ''))
            continue
        forward, backward = mean + 0.5 * table.value, mean - 0.5 * table.value
        both = np.concatenate([forward, backward])
        at = int(np.argmax(np.abs(table.value)))
        found = {'E': float(np.ptp(both)), 'M': float(np.ptp(mean)),
                 'B': float(abs(table.value[at])), 'B_mean': float(table.value.mean()),
                 'u_B': float(table.u[at])}  # fmt: skip
        data[axis] = found
        rows.append((axis, *(micro(v) for v in found.values())))
    stay = 'stay on the side of their last travel' if reversal.held else 'lie between both sides'
    at_target = backlash_words(reversal)
    words = (
        f'Reversal model: {reversal.model}; axes that stand {stay}. A reversal value is the error '
        f'in forward travel (towards larger positions) less that in backward travel.',
        *([f'{at_target[:1].upper()}{at_target[1:]}.'] if at_target else []),
        DERIVED,
    )
    head = ('Axis', 'E, bidirectional systematic deviation', 'M, range of the mean',
            'B, largest reversal value', 'Mean reversal value', 'u of B, k = 1')  # fmt: skip
    tables = (
        Table(head, tuple(rows), numbers=(1, 2, 3, 4, 5), title='Derived, ISO 230-2 style (um)'),
        _all(facts),
    )
    return Section('reversal', 'Forward and backward', words,
                   {'model': reversal.model, 'derived': data}, tables, text)  # fmt: skip


def _all(facts: Facts) -> Table:
    rows = []
    for name, table in facts.result.reversal.motions.items():
        if table.identifiable:
            low, high = float(table.value.min()), float(table.value.max())
            rows.append((name, micro(low), micro(high), micro(float(table.u.mean()))))
        else:
            rows.append((name, 'not known', '', ''))
    head = ('Motion', 'Smallest', 'Largest', 'Mean u, k = 1')
    return Table(head, tuple(rows), numbers=(1, 2, 3), folded='Reversal values of all motions',
                 title='Forward less backward (um, urad)')  # fmt: skip

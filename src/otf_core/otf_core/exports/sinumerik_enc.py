# SPDX-License-Identifier: Apache-2.0
"""SINUMERIK 840D sl, leadscrew and measuring-system error compensation (ENC_COMP).

Source: Siemens, Function Manual Extended Functions 6FC5397-1BP40, K3 Compensations, 4.4.3: one
table per axis, $AA_ENC_COMP[0,N,AXIS] at MIN + N STEP, straight lines between. A positive value
moves the axis in the negative direction: the values are errors. The table has to be zero at the
reference position, and is loaded while MD32700 is 0.
"""

from __future__ import annotations

from otf_core.exports.format import LINE_WORDS, Exported, Format, Request
from otf_core.exports.lattice import OWN_PAIRS, LineTerm, even_terms, held_by, without_table

MAX_POINTS = 5000
DECIMALS = 6


class SinumerikEnc(Format):
    """Measuring-system error compensation, axes named X1, Y1, Z1."""

    name = 'sinumerik-enc'
    value_words = LINE_WORDS
    lacks = (
        'straightness and squareness (see sinumerik-cec), rotations; differences between the '
        'directions of travel'
    )
    takes_points = True

    def sign_words(self, request: Request) -> str:
        """Say what the values are."""
        return (
            'values are errors in mm (actual minus nominal): a positive value moves the axis in '
            'the negative direction'
        )

    def export(self, request: Request) -> Exported:
        """Make the file."""
        self.check(request)
        tables = request.content.tables
        terms = even_terms(tables, OWN_PAIRS, request.points, MAX_POINTS, DECIMALS)
        lines = ['%_N_AX_EEC_INI', *(f'; {line}' for line in request.header(self)), 'CHANDATA(1)']
        axes = tables.machine.axis_names
        for (_, k), term in terms.items():
            lines += _table(term, f'{axes[k]}1')
        counts = ', '.join(f'{axes[k]}1 {len(term.position)}' for (_, k), term in terms.items())
        return Exported(
            {request.name: ('\n'.join([*lines, 'M17']) + '\n').encode()},
            lambda q: held_by(terms, q),
            (
                f'needs MD38000 of at least {counts}; load with MD32700 = 0, then set it to 1 '
                f'and reference; axis names are those of the manual (X1, Y1, Z1)',
                *without_table(tables),
            ),
        )


def _table(term: LineTerm, axis: str) -> list[str]:
    low, high = 1e3 * term.position[0], 1e3 * term.position[-1]
    step = (high - low) / (len(term.position) - 1)
    return [
        *(
            f'$AA_ENC_COMP[0,{n},{axis}]={1e3 * value:.{DECIMALS}f}'
            for n, value in enumerate(term.value)
        ),
        f'$AA_ENC_COMP_STEP[0,{axis}]={step:.9f}',
        f'$AA_ENC_COMP_MIN[0,{axis}]={low:.6f}',
        f'$AA_ENC_COMP_MAX[0,{axis}]={high:.6f}',
        f'$AA_ENC_COMP_IS_MODULO[0,{axis}]=0',
    ]


FORMAT = SinumerikEnc()

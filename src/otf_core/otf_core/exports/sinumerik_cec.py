# SPDX-License-Identifier: Apache-2.0
"""SINUMERIK 840D sl, sag and angularity compensation (CEC): six tables, base axis to other axis.

Source: Siemens, Function Manual Extended Functions 6FC5397-1BP40, K3 Compensations, 4.4.4:
$AN_CEC[t,N] at MIN + N STEP of the input axis acts on the output axis, straight lines between.
The manual does not say in words whether a value is added to or taken off the command: the user
names the sign.
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.exports.format import LINE_WORDS, ExportedFiles, Format, Request, named_sign_words
from otf_core.exports.lattice import (
    CROSS_PAIRS,
    LineTerm,
    Pair,
    axes_without_table,
    error_of_terms,
    even_terms,
    pair_name,
)

MAX_POINTS = 200
"""Points of a table on a SINUMERIK 828D, which cannot be changed."""
DECIMALS = 6
_MOST_WORDS = (
    f'tables are limited to {MAX_POINTS} points, the capacity of an 828D, although nodes of the '
    f'error tables may be closer; set another number with --points'
)


class SinumerikCec(Format):
    """Sag and angularity compensation, axes named X1, Y1, Z1."""

    name = 'sinumerik-cec'
    value_words = LINE_WORDS
    lacks = (
        'positioning (see sinumerik-enc), rotations with their levers; differences between the '
        'directions of travel'
    )
    sign_is_asked = True
    takes_points = True

    def sign_words(self, request: Request) -> str:
        """State what the values are."""
        return named_sign_words(request) + ', mm'

    def export(self, request: Request) -> ExportedFiles:
        """Make the file."""
        self.check(request)
        tables = request.content.tables
        terms = even_terms(tables, CROSS_PAIRS, request.points, MAX_POINTS, DECIMALS)
        lines = ['%_N_NC_CEC_INI', *(f'; {line}' for line in request.header(self)), 'CHANDATA(1)']
        axes = tables.machine.axis_names
        for number, (pair, term) in enumerate(terms.items()):
            lines += _table(number, pair, axes, term, request.factor)
        most = max(len(term.position) for term in terms.values())
        return ExportedFiles(
            {request.name: ('\n'.join([*lines, 'M17']) + '\n').encode()},
            lambda q: error_of_terms(terms, q),
            (
                f'needs {len(terms)} tables of at least {most} points (MD18342); load with '
                f'MD32710 = 0, then MD32710 = 1 for the axes and SD41300 = 1 for the tables',
                *((_MOST_WORDS,) if request.points is None and most == MAX_POINTS else ()),
                *axes_without_table(tables),
            ),
        )


def _table(
    number: int, pair: Pair, axes: Sequence[str], term: LineTerm, factor: float
) -> list[str]:
    low, high = 1e3 * term.position[0], 1e3 * term.position[-1]
    step = (high - low) / (len(term.position) - 1)
    return [
        f'; {pair_name(pair, axes)}',
        *(
            f'$AN_CEC[{number},{n}]={factor * 1e3 * value + 0.0:.{DECIMALS}f}'
            for n, value in enumerate(term.value)
        ),
        f'$AN_CEC_INPUT_AXIS[{number}]="{axes[pair[1]]}1"',
        f'$AN_CEC_OUTPUT_AXIS[{number}]="{axes[pair[0]]}1"',
        f'$AN_CEC_STEP[{number}]={step:.9f}',
        f'$AN_CEC_MIN[{number}]={low:.6f}',
        f'$AN_CEC_MAX[{number}]={high:.6f}',
        f'$AN_CEC_DIRECTION[{number}]=0',
        f'$AN_CEC_MULT_BY_TABLE[{number}]=0',
        f'$AN_CEC_IS_MODULO[{number}]=0',
    ]


FORMAT = SinumerikCec()

# SPDX-License-Identifier: Apache-2.0
"""SINUMERIK 840D sl, leadscrew and measuring-system error compensation (ENC_COMP).

Source: Siemens, Function Manual Extended Functions 6FC5397-1BP40, K3 Compensations, 4.4.3: one
table per axis, $AA_ENC_COMP[0,N,AXIS] at MIN + N STEP, straight lines between. A positive value
moves the axis in the negative direction: the values are errors. The table has to be zero at the
reference position, and is loaded while MD32700 is 0. Of a rotary axis positions and values are in
degrees; IS_MODULO joins the ends of a full turn.
"""

from __future__ import annotations

import numpy as np

from otf_core.exports.format import LINE_WORDS, ExportedFiles, Format, Request
from otf_core.exports.lattice import (
    OWN_PAIRS,
    LineTerm,
    axes_without_table,
    displacement_by_terms,
    even_terms,
    linear_tables,
    rotary_term,
)
from otf_core.model.machine import FULL_TURN, Machine

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
    takes_rotary = True

    def sign_words(self, request: Request) -> str:
        """State what the values are."""
        return (
            'values are errors in mm (actual minus nominal): a positive value moves the axis in '
            'the negative direction'
        )

    def export(self, request: Request) -> ExportedFiles:
        """Make the file."""
        self.check(request)
        tables = request.content.tables
        machine = tables.machine
        linear = even_terms(linear_tables(tables), OWN_PAIRS, request.points, MAX_POINTS, DECIMALS)
        terms = {machine.axis_names[k]: term for (_, k), term in linear.items()}
        for axis in machine.rotary_names:
            turning = rotary_term(tables, axis, request.points, MAX_POINTS, DECIMALS)
            if turning is not None:
                terms[axis] = turning
        lines = ['%_N_AX_EEC_INI', *(f'; {line}' for line in request.header(self))]
        lines += [*(f'; {line}' for line in _rotary_words(machine)), 'CHANDATA(1)']
        for axis, term in terms.items():
            lines += _table(machine, axis, term)
        counts = ', '.join(f'{axis}1 {len(term.position)}' for axis, term in terms.items())
        return ExportedFiles(
            {request.name: ('\n'.join([*lines, 'M17']) + '\n').encode()},
            lambda q: displacement_by_terms(machine, terms, q),
            (
                f'needs MD38000 of at least {counts}; load with MD32700 = 0, then set it to 1 '
                f'and reference; axis names are those of the manual (X1, Y1, Z1)',
                *_rotary_words(machine),
                *axes_without_table(tables),
            ),
        )


def _rotary_words(machine: Machine) -> tuple[str, ...]:
    if not machine.rotary_names:
        return ()
    own = ', '.join(f'E{a}{a}' for a in machine.rotary_names)
    return (
        f'of {", ".join(machine.rotary_names)} only the angular positioning ({own}) in degrees, '
        'positive in the sense of the programmed angle; tables of the linear axes hold with the '
        'rotary axes at zero; location errors: see pivot',
    )


def _table(machine: Machine, axis: str, term: LineTerm) -> list[str]:
    own = machine.axes[axis]
    scale = np.degrees(1.0) if own.rotary else 1e3
    modulo = own.endless and np.ptp(term.position) > FULL_TURN - 1e-6
    name = f'{axis}1'
    low, high = scale * term.position[0], scale * term.position[-1]
    step = (high - low) / (len(term.position) - 1)
    return [
        *(
            f'$AA_ENC_COMP[0,{n},{name}]={scale * value:.{DECIMALS}f}'
            for n, value in enumerate(term.value)
        ),
        f'$AA_ENC_COMP_STEP[0,{name}]={step:.9f}',
        f'$AA_ENC_COMP_MIN[0,{name}]={low:.6f}',
        f'$AA_ENC_COMP_MAX[0,{name}]={high:.6f}',
        f'$AA_ENC_COMP_IS_MODULO[0,{name}]={int(modulo)}',
    ]


FORMAT = SinumerikEnc()

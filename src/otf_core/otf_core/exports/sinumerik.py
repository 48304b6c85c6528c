# SPDX-License-Identifier: Apache-2.0
"""SINUMERIK 840D sl: positioning (ENC_COMP), and straightness with squareness (CEC).

Source: Siemens, Function Manual Extended Functions 6FC5397-1BP40, K3 Compensations; axes are named
X1, Y1, Z1. 4.4.3, leadscrew and measuring-system error compensation: one table per axis,
$AA_ENC_COMP[0,N,AXIS] at MIN + N STEP, straight lines between. A positive value moves the axis in
the negative direction: the values are errors. The table has to be zero at the reference position,
and is loaded while MD32700 is 0. Of a rotary axis positions and values are in degrees; IS_MODULO
joins the ends of a full turn. 4.4.4, sag and angularity compensation: $AN_CEC[t,N] at MIN + N STEP
of the input axis acts on the output axis. The manual does not say in words whether a value is
added to or taken off the command: the user names the sign.
"""

from __future__ import annotations

import numpy as np

from otf_core.errors import ConfigError
from otf_core.exports.format import LINE_WORDS, ExportedFiles, Format, Request
from otf_core.exports.terms import (
    LineTerm,
    Pair,
    control_unit,
    cross_pairs,
    error_of_terms,
    even_terms,
    own_pairs,
    term_remarks,
)
from otf_core.model.machine import FULL_TURN, Machine

MOST_ENC, MOST_CEC = 5000, 200
"""Points of a table; of CEC those on a SINUMERIK 828D, which cannot be changed."""
DECIMALS = 6


def _make(fmt: Format, request: Request) -> ExportedFiles:
    tables = request.content.tables
    machine, positioning = tables.machine, fmt.name == 'sinumerik-enc'
    pairs, most = (
        (own_pairs(machine), MOST_ENC) if positioning else (cross_pairs(machine), MOST_CEC)
    )
    terms = even_terms(tables, pairs, request.points, most, DECIMALS)
    if not terms:
        raise ConfigError(
            f'--format {fmt.name}: no table to write: it needs '
            f'{"an axis" if positioning else "two linear axes"} that moved in the calibration'
        )
    counts = {f'{axis}1': len(term.position) for (_, axis), term in terms.items()}
    remarks = list(term_remarks(machine, pairs))
    if still := [a for a in dict.fromkeys(a for _, a in pairs) if f'{a}1' not in counts]:
        remarks.append(
            f'{", ".join(still)}: did not move in the calibration, so no table over its positions'
        )
    head = '%_N_AX_EEC_INI' if positioning else '%_N_NC_CEC_INI'
    lines = [head, *(f'; {line}' for line in (*request.header(fmt), *remarks)), 'CHANDATA(1)']
    for number, (pair, term) in enumerate(terms.items()):
        table = _enc_table if positioning else _cec_table
        lines += table(machine, number, pair, term, request.factor)
    if positioning:
        needs = (
            f'needs MD38000 of at least {", ".join(f"{a} {n}" for a, n in counts.items())}; load '
            f'with MD32700 = 0, then set it to 1 and reference; axis names are those of the '
            f'manual (X1, Y1, Z1)'
        )
    else:
        largest = max(counts.values(), default=0)
        needs = (
            f'needs {len(terms)} tables of at least {largest} points (MD18342); load with '
            f'MD32710 = 0, then MD32710 = 1 for the axes and SD41300 = 1 for the tables'
        )
        if request.points is None and largest == MOST_CEC:
            remarks.append(
                f'tables are limited to {MOST_CEC} points, the capacity of an 828D, although '
                f'nodes of the error tables may be closer; set another number with --points'
            )
    return ExportedFiles(
        {request.name: ('\n'.join([*lines, 'M17']) + '\n').encode()},
        lambda q: error_of_terms(machine, terms, q),
        (needs, *remarks),
    )


def _evenly(machine: Machine, axis: str, term: LineTerm) -> tuple[float, float, float]:
    """Step, first and last position of a table, mm or degrees."""
    low, high = control_unit(machine, axis) * term.position[[0, -1]]
    return (high - low) / (len(term.position) - 1), low, high


def _enc_table(
    machine: Machine, number: int, pair: Pair, term: LineTerm, factor: float
) -> list[str]:
    own, name, scale = machine.axes[pair[1]], f'{pair[1]}1', control_unit(machine, pair[1])
    modulo = own.endless and np.ptp(term.position) > FULL_TURN - 1e-6
    step, low, high = _evenly(machine, pair[1], term)
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


def _cec_table(
    machine: Machine, number: int, pair: Pair, term: LineTerm, factor: float
) -> list[str]:
    step, low, high = _evenly(machine, pair[1], term)
    return [
        f'; error along {pair[0]} with {pair[1]}',
        *(
            f'$AN_CEC[{number},{n}]={factor * 1e3 * value + 0.0:.{DECIMALS}f}'
            for n, value in enumerate(term.value)
        ),
        f'$AN_CEC_INPUT_AXIS[{number}]="{pair[1]}1"',
        f'$AN_CEC_OUTPUT_AXIS[{number}]="{pair[0]}1"',
        f'$AN_CEC_STEP[{number}]={step:.9f}',
        f'$AN_CEC_MIN[{number}]={low:.6f}',
        f'$AN_CEC_MAX[{number}]={high:.6f}',
        f'$AN_CEC_DIRECTION[{number}]=0',
        f'$AN_CEC_MULT_BY_TABLE[{number}]=0',
        f'$AN_CEC_IS_MODULO[{number}]=0',
    ]


FORMATS = (
    Format(
        'sinumerik-enc',
        _make,
        LINE_WORDS,
        'values are errors in mm (actual minus nominal): a positive value moves the axis in the '
        'negative direction',
        'straightness and squareness (see sinumerik-cec), rotations; differences between the '
        'directions of travel',
        takes_points=True,
    ),
    Format(
        'sinumerik-cec',
        _make,
        LINE_WORDS,
        ', mm',
        'positioning (see sinumerik-enc), rotations with their levers; differences between the '
        'directions of travel',
        sign_is_asked=True,
        takes_points=True,
    ),
)

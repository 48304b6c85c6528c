# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC: one compensation file per joint, and the piece of the INI file that names them.

Source: LinuxCNC 2.9, ``docs/src/config/ini-config.adoc`` (COMP_FILE, COMP_FILE_TYPE) and
``src/emc/usr_intf/usrmotintf.cc``: lines "nominal forward reverse" in machine units, strictly
ascending, at most 256, straight lines between them and constant outside; reading ends at the
first line that is not three numbers, so words stand below the numbers. Type 0: the columns are
actual positions in positive and in negative travel; the control adds nominal minus actual. The
unit of an angular joint is the degree.
"""

from __future__ import annotations

from pathlib import PurePath

import numpy as np

from otf_core.arrays import Array
from otf_core.exports.format import LINE_WORDS, ExportedFiles, Format, Request
from otf_core.exports.lattice import (
    OWN_PAIRS,
    LineTerm,
    axis_positions,
    displacement_by_terms,
    half_reversal,
    line_terms,
    linear_tables,
    rotary_term,
)
from otf_core.model.machine import Machine
from otf_core.model.tables import ErrorTables

MAX_LINES = 256
"""Lines that the control reads of a file."""
DECIMALS = 6


class LinuxCnc(Format):
    """LinuxCNC 2.8 and later: joints 0, 1, 2 are X, Y, Z, rotary axes follow in their order."""

    name = 'linuxcnc'
    value_words = LINE_WORDS
    lacks = 'straightness, rotations and squareness (a file per joint corrects its own axis only)'
    takes_points = True
    takes_rotary = True

    def sign_words(self, request: Request) -> str:
        """State what the values are."""
        return (
            'COMP_FILE_TYPE = 0: columns 2 and 3 are the actual positions in mm at the nominal '
            'position in column 1 (actual = nominal + error), for forward and backward travel'
        )

    def export(self, request: Request) -> ExportedFiles:
        """Make the INI piece and a file per joint."""
        self.check(request)
        tables, stem = request.content.tables, PurePath(request.name).stem
        machine = tables.machine
        terms, remarks = _terms(tables, request.points)
        words = [f'# {line}' for line in (*request.header(self), *_rotary_words(machine))]
        ini = f'{stem}.ini'
        files, piece, reversals = {ini: b''}, list(words), []
        for k, axis in enumerate(machine.axis_names):
            if axis not in terms:
                continue
            name, rotary = f'{stem}_{axis.lower()}.comp', machine.axes[axis].rotary
            half = np.zeros(1)
            if not machine.rotary_names:
                half = half_reversal(request.content, k, terms[axis].position)
                reversals.append(f'{axis} {2e6 * half.mean() + 0.0:.2f} um')
            files[name] = _joint_file(terms[axis], half, words, np.degrees(1) if rotary else 1e3)
            piece += [f'[JOINT_{k}]', f'COMP_FILE = {name}', 'COMP_FILE_TYPE = 0']
        files[ini] = ('\n'.join(piece) + '\n').encode()
        reversal = (
            f'columns 2 and 3 hold the reversal, on average {", ".join(reversals)} (backlash at '
            'the target in the summary of the calibration)'
            if reversals
            else 'columns 2 and 3 are equal: they hold the mean of both directions'
        )
        return ExportedFiles(
            files,
            lambda q: displacement_by_terms(machine, terms, q),
            (
                'put the lines of the .ini file into the sections of that name in the INI file of '
                'the machine (a section that comes twice is read once); BACKLASH of a joint with '
                f'COMP_FILE is ignored: {reversal}',
                *_rotary_words(machine),
                *remarks,
            ),
        )


def _terms(tables: ErrorTables, points: int | None) -> tuple[dict[str, LineTerm], list[str]]:
    """Positioning by axis as the files hold it, and remarks where lines are fewer than wanted."""
    positions, remarks = _positions(tables, points)
    machine = tables.machine
    terms = {}
    for (_, k), term in line_terms(linear_tables(tables), OWN_PAIRS, positions).items():
        nominal = term.position.round(DECIMALS + 3)
        error = (nominal + term.value).round(DECIMALS + 3) - nominal
        terms[machine.axis_names[k]] = LineTerm(nominal, error)
    for axis in machine.rotary_names:
        turning = rotary_term(tables, axis, points, MAX_LINES, DECIMALS)
        if turning is not None:
            terms[axis] = turning
    return terms, remarks


def _rotary_words(machine: Machine) -> tuple[str, ...]:
    """What the files of rotary joints hold; nothing without any."""
    if not machine.rotary_names:
        return ()
    own = ', '.join(f'E{a}{a}' for a in machine.rotary_names)
    endless = [a for a in machine.rotary_names if machine.axes[a].endless]
    turn = f'; {", ".join(endless)}: within the turn of the table only' if endless else ''
    return (
        f'files of {", ".join(machine.rotary_names)}: actual angles in degrees, angular '
        f'positioning ({own}){turn}; those of the linear axes hold with the rotary axes at zero; '
        'location errors: see pivot',
    )


def _positions(tables: ErrorTables, points: int | None) -> tuple[dict[int, Array], list[str]]:
    """Positions of the lines by linear joint, m, and remarks where lines are fewer than wanted."""
    positions, remarks = {}, []
    for k, axis in enumerate(linear_tables(tables).machine.axis_names):
        positions[k] = axis_positions(tables, k, points)
        count = len(positions[k])
        if count > MAX_LINES:
            positions[k] = axis_positions(tables, k, MAX_LINES)
            remarks.append(
                f'{axis}: {MAX_LINES} lines, evenly spread, instead of {count}; the control '
                f'reads no more'
            )
    return positions, remarks


def _joint_file(term: LineTerm, half: Array, words: list[str], unit: float) -> bytes:
    """Lines of one joint; ``unit`` is that of the control per m or rad."""
    actual = term.position + term.value
    columns = unit * np.column_stack([term.position, actual + half, actual - half])
    rows = [' '.join(f'{v + 0.0:.{DECIMALS}f}' for v in row.round(DECIMALS)) for row in columns]
    return ('\n'.join([*rows, *words]) + '\n').encode()


FORMAT = LinuxCnc()

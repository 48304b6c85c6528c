# SPDX-License-Identifier: Apache-2.0
"""HEIDENHAIN KinematicsComp columns, for the table editor: experimental.

Source: HEIDENHAIN iTNC 530 HSCI Technical Manual, KinematicsComp: component errors of an axis
stand in the columns C1 ... C6 (EXX, EYX, EZX, EAX, EBX, ECX), the positioning error of a rotary
axis in a column of its own, constants in the description of the kinematics. The framing of the
table files and the sign were found in no manual: this is a CSV of the same columns, and the user
names the sign.
"""

from __future__ import annotations

import numpy as np

from otf_core.exports.format import (
    TABLE_WORDS,
    ExportedFiles,
    Format,
    Request,
    lever_words,
    named_sign_words,
    rotary_words,
    rounded_tables,
)
from otf_core.model.kinematics import displacement
from otf_core.model.motions import DIRECTIONS, unit_of
from otf_core.model.tables import ErrorTables


class Heidenhain(Format):
    """Columns to be typed or pasted into the table editor."""

    name = 'heidenhain'
    value_words = TABLE_WORDS
    lacks = (
        'the framing of a .COM file (experimental: columns for the table editor only); '
        'differences between the directions of travel'
    )
    sign_is_asked = True
    takes_rotary = True

    def sign_words(self, request: Request) -> str:
        """State what the values are."""
        return named_sign_words(request) + '; positions and C1-C3 in mm, C4-C6 in rad'

    def export(self, request: Request) -> ExportedFiles:
        """Make the CSV."""
        self.check(request)
        tables = rounded_tables(request.content.tables)
        machine = tables.machine
        constants = ', '.join(_constant(tables, name, request.factor) for name in machine.scalars)
        unit = '' if machine.rotary_names else ', rad'
        lines = [f'# {line}' for line in request.header(self)]
        lines += [f'# {line}' for line in (lever_words(machine), *rotary_words(machine))]
        lines += [f'# constants for the kinematics{unit}: {constants}']
        lines += ['AXIS,AXISPOS,C1,C2,C3,C4,C5,C6' + (',OWN' if machine.rotary_names else '')]
        if machine.rotary_names:
            lines.insert(
                -1, '# OWN: positioning error of a rotary axis, rad; its AXISPOS in degrees'
            )
        for axis in machine.axis_names:
            lines += _rows(tables, axis, request.factor)
        return ExportedFiles(
            {request.name: ('\n'.join(lines) + '\n').encode()},
            lambda q: displacement(tables, q),
            (
                'experimental: never tested on a control; verify by measurement before use',
                *request.unseen_words,
            ),
        )


def _constant(tables: ErrorTables, name: str, factor: float) -> str:
    """A squareness or location error, its unit named where there are two."""
    length = unit_of(name) == 'm'
    value = factor * tables.scalar(name) * (1e3 if length else 1.0) + 0.0
    unit = (' mm' if length else ' rad') if tables.machine.rotary_names else ''
    return f'{name} {value:.9f}{unit}'


def _rows(tables: ErrorTables, axis: str, factor: float) -> list[str]:
    """Lines of one axis: mm, of a rotary axis degrees, and its own positioning at the end."""
    machine = tables.machine
    rotary = machine.axes[axis].rotary
    digits, scale = (9, np.degrees(1.0)) if rotary else (6, 1e3)
    motions = [tables.motions[f'E{d}{axis}'] for d in DIRECTIONS]
    lines = []
    for q in np.unique(np.concatenate([m.position for m in motions]).round(12)):
        values = [round(factor * float(m.at(q)), 9) + 0.0 for m in motions]
        if machine.rotary_names:
            values.append(0.0)
        if rotary:
            own = DIRECTIONS.index(axis)
            values[own], values[-1] = 0.0, values[own]
        texts = [f'{1e3 * v:.6f}' for v in values[:3]] + [f'{v:.9f}' for v in values[3:]]
        lines.append(','.join([axis, f'{scale * q:.{digits}f}', *texts]))
    return lines


FORMAT = Heidenhain()

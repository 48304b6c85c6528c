# SPDX-License-Identifier: Apache-2.0
"""HEIDENHAIN KinematicsComp columns, for the table editor: experimental.

Source: HEIDENHAIN iTNC 530 HSCI Technical Manual, KinematicsComp: component errors of an axis
stand in the columns C1 ... C6 (EXX, EYX, EZX, EAX, EBX, ECX), constants in the description of the
kinematics. The framing of the table files and the sign were found in no manual: this is a CSV of
the same columns, and the user names the sign.
"""

from __future__ import annotations

import numpy as np

from otf_core.exports.format import (
    TABLE_WORDS,
    Exported,
    Format,
    Request,
    asked_sign_words,
    lever_words,
    rounded_tables,
)
from otf_core.model.kinematics import displacement
from otf_core.model.motions import DIRECTIONS, SQUARENESS


class Heidenhain(Format):
    """Columns to be typed or pasted into the table editor."""

    name = 'heidenhain'
    value_words = TABLE_WORDS
    lacks = (
        'the framing of a .COM file (experimental: columns for the table editor only); '
        'differences between the directions of travel'
    )
    sign_is_asked = True

    def sign_words(self, request: Request) -> str:
        """Say what the values are."""
        return asked_sign_words(request) + '; positions and C1-C3 in mm, C4-C6 in rad'

    def export(self, request: Request) -> Exported:
        """Make the CSV."""
        self.check(request)
        tables = rounded_tables(request.content.tables)
        lines = [f'# {line}' for line in request.header(self)]
        square = ', '.join(
            f'{k} {request.factor * tables.squareness[k].value + 0.0:.9f}' for k in SQUARENESS
        )
        lines += [f'# {lever_words(tables.machine)}']
        lines += [f'# constants for the kinematics, rad: {square}']
        lines += ['AXIS,AXISPOS,C1,C2,C3,C4,C5,C6']
        for axis in tables.machine.axis_names:
            motions = [tables.motions[f'E{d}{axis}'] for d in DIRECTIONS]
            for q in np.unique(np.concatenate([m.position for m in motions]).round(12)):
                values = [round(request.factor * float(m.at(q)), 9) + 0.0 for m in motions]
                texts = [f'{1e3 * v:.6f}' for v in values[:3]] + [f'{v:.9f}' for v in values[3:]]
                lines.append(','.join([axis, f'{1e3 * q:.6f}', *texts]))
        return Exported(
            {request.name: ('\n'.join(lines) + '\n').encode()},
            lambda q: displacement(tables, q),
            (
                'experimental: never tested on a control; verify by measurement before use',
                *request.unseen_words,
            ),
        )


FORMAT = Heidenhain()

# SPDX-License-Identifier: Apache-2.0
"""Etalon exchange format: a text of blocks ``[EXX]`` ..., for controls that import it.

Source: Beckhoff Information System, TF5280 Volumetric Compensation, "Etalon exchange format", and
the same page of the ISG kernel manual: the name of a parameter in square brackets; ``//`` begins a
comment; location errors and squareness as ``VALUE = number``; tables as ``Gridpoints = {``, a line
"argument value" a point, ``}``. Values in mm and rad, arguments in mm, of rotary axes in degrees.
These pages do not state sign, reference point, zero and meaning outside of the grid: comments do.
They name two variants of the format, "Vendor" and "Kinematic", but not how they differ.
"""

from __future__ import annotations

import numpy as np

from otf_core.exports.format import (
    TABLE_WORDS,
    WORKPIECE_WORDS,
    ExportedFiles,
    Format,
    Request,
    lever_words,
    rotary_words,
    rounded_tables,
)
from otf_core.model.kinematics import displacement
from otf_core.model.motions import unit_of

GRID_WORDS = (
    'arguments are programmed positions: mm, of rotary axes degrees; straight lines between grid '
    'points; outside of the grid the value of its last point holds',
    'squareness is in [C0Y], [B0Z], [A0Z] alone and in no table: C0Y > 0 tilts +Y to -X, B0Z > 0 '
    'tilts +Z to +X, A0Z > 0 tilts +Z to -Y',
)
VARIANT_WORDS = (
    'the format has variants "Vendor" and "Kinematic" whose difference is not published; controls '
    'with the ISG kernel take "Vendor": verify by measurement before use'
)


class Etalon(Format):
    """All motions, squareness and location errors in ISO 230 names, a block each."""

    name = 'etalon'
    value_words = TABLE_WORDS
    lacks = 'differences between the directions of travel; uncertainties'
    takes_rotary = True

    def sign_words(self, request: Request) -> str:
        """State what the values are."""
        return (
            'values are errors (actual minus nominal); lengths in mm, angles in rad, right-handed'
        )

    def export(self, request: Request) -> ExportedFiles:
        """Make the text."""
        self.check(request)
        tables = rounded_tables(request.content.tables)
        machine, gauge = tables.machine, request.content.extra.get('gauge')
        rotary = rotary_words(machine)
        comments = [*request.header(self), lever_words(machine), *rotary, *GRID_WORDS]
        comments.append(f'zero of the tables: {gauge or "as stated by their source"}')
        lines = [f'// {" ".join(line.split())}' for line in comments]
        for name in machine.scalars:
            scale = 1e3 if unit_of(name) == 'm' else 1.0
            lines += [f'[{name}]', f'VALUE = {scale * tables.scalar(name) + 0.0:.9f}']
        for motion in machine.motions:
            table = tables.motions[motion]
            degrees = machine.axes[str(motion)[-1]].rotary
            argument = (np.degrees(1.0) if degrees else 1e3) * table.position + 0.0
            value, digits = (1e3, 6) if unit_of(motion) == 'm' else (1.0, 9)
            lines += [f'[{motion}]', 'Gridpoints = {']
            lines += [
                f'{a:.9f} {value * v + 0.0:.{digits}f}'
                for a, v in zip(argument, table.value, strict=True)
            ]
            lines.append('}')
        return ExportedFiles(
            {request.name: ('\n'.join(lines) + '\n').encode()},
            lambda q: displacement(tables, q),
            (
                VARIANT_WORDS,
                *rotary[:1],
                *((WORKPIECE_WORDS,) if rotary else ()),
                *request.unseen_words,
            ),
        )


FORMAT = Etalon()

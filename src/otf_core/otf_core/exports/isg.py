# SPDX-License-Identifier: Apache-2.0
"""ISG kernel and TwinCAT CNC, volumetric compensation (TF5280): tabular ISG CSV.

Source: Beckhoff Information System, TF5280 Volumetric Compensation, "ISG CSV format", "Units of
measure", "List of parameters supported": a header names arguments and ISO 230 parameters, rows
follow, ``//`` begins a comment line, ``#`` a new block; values in mm and rad, arguments in mm, of
rotary axes in degrees; PXC, PYC, PZC are the centre of rotation of C. The manual does not say in
words whether values are errors or corrections (there is a switch ``negate``), nor in which frame
errors of rotary axes act: the user names the sign, and the file says the frame.
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
    named_sign_words,
    rotary_words,
    rounded_tables,
)
from otf_core.model.kinematics import displacement
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS, unit_of
from otf_core.model.tables import ErrorTables


class Isg(Format):
    """All motions, squareness and location errors in ISO 230 names."""

    name = 'isg'
    value_words = TABLE_WORDS
    lacks = 'differences between the directions of travel; uncertainties'
    sign_is_asked = True
    takes_rotary = True

    def sign_words(self, request: Request) -> str:
        """State what the values are."""
        return named_sign_words(request) + '; lengths in mm, angles in rad, right-handed'

    def export(self, request: Request) -> ExportedFiles:
        """Make the CSV; its configuration is in the remarks."""
        self.check(request)
        tables = rounded_tables(request.content.tables)
        machine = tables.machine
        constants = {
            name: request.factor * tables.scalar(name) * (1e3 if unit_of(name) == 'm' else 1.0)
            for name in machine.scalars
        }
        for axis in machine.rotary_names:
            centre = zip('XYZ', machine.axes[axis].centre, strict=True)
            constants |= {f'P{d}{axis}': 1e3 * v for d, v in centre}
        rotary = rotary_words(machine)
        lines = [f'// {line}' for line in request.header(self)]
        lines += [f'// {line}' for line in (lever_words(machine), *rotary)]
        lines += [
            '\t'.join(constants),
            '\t'.join(f'{v:.9f}' for v in constants.values()),
        ]
        for axis in machine.axis_names:
            lines += ['#', *_block(tables, axis, request.factor)]
        return ExportedFiles(
            {request.name: ('\n'.join(lines) + '\n').encode()},
            lambda q: displacement(tables, q),
            (
                _configuration(machine, request.name, len(lines)),
                *rotary[:1],
                *((WORKPIECE_WORDS,) if rotary else ()),
                *request.unseen_words,
            ),
        )


def _block(tables: ErrorTables, axis: str, factor: float) -> list[str]:
    """Header and rows of one axis; motions with other nodes are sampled at all of them.

    Positions in mm, of a rotary axis in degrees.
    """
    digits, scale = (9, np.degrees(1.0)) if tables.machine.axes[axis].rotary else (6, 1e3)
    motions = [tables.motions[f'E{d}{axis}'] for d in DIRECTIONS]
    nodes = np.unique(np.concatenate([m.position for m in motions]).round(12))
    lines = ['\t'.join([axis, *(f'E{d}{axis}' for d in DIRECTIONS)])]
    for q in nodes:
        values = [round(float(m.at(q)) * factor, 9) for m in motions]
        texts = [f'{1e3 * v + 0.0:.6f}' for v in values[:3]]
        texts += [f'{v + 0.0:.9f}' for v in values[3:]]
        lines.append('\t'.join([f'{scale * q:.{digits}f}', *texts]))
    return lines


def _configuration(machine: Machine, name: str, records: int) -> str:
    chain = ''.join(machine.chain.table_side + machine.chain.target_side)
    return (
        f'compensation list: chain {chain}, workpiece_axes {len(machine.chain.table_side)}, '
        f'Interpolation GRID, file[0] {name}, file_format[0] ISG_CSV, max_records {records} or '
        f'more; lever arms and sign follow the model of the kernel: verify by measurement '
        f'before use'
    )


FORMAT = Isg()

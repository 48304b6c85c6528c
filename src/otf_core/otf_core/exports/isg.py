# SPDX-License-Identifier: Apache-2.0
"""ISG kernel and TwinCAT CNC, volumetric compensation (TF5280): tabular ISG CSV.

Source: Beckhoff Information System, TF5280 Volumetric Compensation, "ISG CSV format", "Units of
measure", "List of parameters supported": a header names arguments and ISO 230 parameters, rows
follow, ``//`` begins a comment line, ``#`` a new block; lengths in mm, angles in rad. The manual
does not say in words whether values are errors or corrections (there is a switch ``negate``):
the user names the sign.
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
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS, SQUARENESS
from otf_core.model.tables import ErrorTables


class Isg(Format):
    """All 18 motions and three squareness errors in ISO 230 names."""

    name = 'isg'
    value_words = TABLE_WORDS
    lacks = 'differences between the directions of travel; uncertainties'
    sign_is_asked = True

    def sign_words(self, request: Request) -> str:
        """Say what the values are."""
        return asked_sign_words(request) + '; lengths in mm, angles in rad, right-handed'

    def export(self, request: Request) -> Exported:
        """Make the CSV; its configuration is in the remarks."""
        self.check(request)
        tables = rounded_tables(request.content.tables)
        lines = [f'// {line}' for line in request.header(self)]
        lines += [
            f'// {lever_words(tables.machine)}',
            '\t'.join(SQUARENESS),
            '\t'.join(f'{request.factor * tables.squareness[k].value:.9f}' for k in SQUARENESS),
        ]
        for axis in tables.machine.axis_names:
            lines += ['#', *_block(tables, axis, request.factor)]
        return Exported(
            {request.name: ('\n'.join(lines) + '\n').encode()},
            lambda q: displacement(tables, q),
            (_configuration(tables.machine, request.name, len(lines)), *request.unseen_words),
        )


def _block(tables: ErrorTables, axis: str, factor: float) -> list[str]:
    """Header and rows of one axis; motions with other nodes are sampled at all of them."""
    motions = [tables.motions[f'E{d}{axis}'] for d in DIRECTIONS]
    nodes = np.unique(np.concatenate([m.position for m in motions]).round(12))
    lines = ['\t'.join([axis, *(f'E{d}{axis}' for d in DIRECTIONS)])]
    for q in nodes:
        values = [round(float(m.at(q)) * factor, 9) for m in motions]
        texts = [f'{1e3 * v + 0.0:.6f}' for v in values[:3]]
        texts += [f'{v + 0.0:.9f}' for v in values[3:]]
        lines.append('\t'.join([f'{1e3 * q:.6f}', *texts]))
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

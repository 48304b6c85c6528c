# SPDX-License-Identifier: Apache-2.0
"""Tables in ISO 230 names for controls with the ISG kernel: ISG CSV and Etalon exchange format.

Source: Beckhoff Information System, TF5280 Volumetric Compensation, and the same pages of the ISG
kernel manual. "ISG CSV format", "Units of measure", "List of parameters supported": a header names
arguments and parameters, rows follow, ``//`` begins a comment line, ``#`` a new block; values in
mm and rad, arguments in mm, of rotary axes in degrees; PXC, PYC, PZC are the centre of rotation of
C. The manual does not say in words whether values are errors or corrections (there is a switch
``negate``), nor in which frame errors of rotary axes act: the user names the sign, and the file
says the frame. "Etalon exchange format": the name of a parameter in square brackets; location
errors and squareness as ``VALUE = number``; tables as ``Gridpoints = {``, a line "argument value"
a point, ``}``; the same units. These pages do not state sign, reference point, zero and meaning
outside of the grid: comments do. They name two variants, "Vendor" and "Kinematic", but not how
they differ.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.exports.format import (
    TABLE_WORDS,
    ExportedFiles,
    Format,
    Request,
    frame_words,
    workpiece_remarks,
)
from otf_core.exports.terms import control_unit
from otf_core.model.chain import displacement
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS, unit_of
from otf_core.model.tables import ErrorTables

GRID_WORDS = (
    'arguments are programmed positions: mm, of rotary axes degrees; straight lines between grid '
    'points; outside of the grid the value of its last point holds'
)
TILT_WORDS = {
    'C0Y': 'C0Y > 0 tilts +Y to -X',
    'B0Z': 'B0Z > 0 tilts +Z to +X',
    'A0Z': 'A0Z > 0 tilts +Z to -Y',
}
VARIANT_WORDS = (
    'the format has variants "Vendor" and "Kinematic" whose difference is not published; controls '
    'with the ISG kernel take "Vendor": verify by measurement before use'
)


def value_unit(name: str) -> float:
    """Unit of the file per m or rad of an error: mm, or rad."""
    return 1e3 if unit_of(name) == 'm' else 1.0


def _exported(
    request: Request, tables: ErrorTables, lines: Sequence[str], words: str
) -> ExportedFiles:
    return ExportedFiles(
        {request.name: ('\n'.join(lines) + '\n').encode()},
        lambda q: displacement(tables, q),
        (words, *workpiece_remarks(tables.machine), *request.unseen_words),
    )


def _isg(fmt: Format, request: Request) -> ExportedFiles:
    """Make the CSV; its configuration is in the remarks."""
    tables = request.content.tables
    machine = tables.machine
    constants = {n: request.factor * tables.scalar(n) * value_unit(n) for n in machine.scalars}
    for axis in machine.rotary_names:
        centre = zip('XYZ', machine.axes[axis].centre, strict=True)
        constants |= {f'P{d}{axis}': 1e3 * v for d, v in centre}
    lines = [f'// {line}' for line in (*request.header(fmt), *frame_words(machine))]
    if constants:
        lines += ['\t'.join(constants), '\t'.join(f'{v:.9f}' for v in constants.values())]
    for axis in machine.axis_names:
        lines += ['#', *_block(tables, axis, request.factor)]
    return _exported(request, tables, lines, _configuration(machine, request.name, len(lines)))


def _block(tables: ErrorTables, axis: str, factor: float) -> list[str]:
    """Header and rows of one axis; motions with other nodes are sampled at all of them."""
    digits = 9 if tables.machine.axes[axis].rotary else 6
    motions = [tables.motions[f'E{d}{axis}'] for d in DIRECTIONS]
    nodes = np.unique(np.concatenate([m.position for m in motions]).round(12))
    lines = ['\t'.join([axis, *(f'E{d}{axis}' for d in DIRECTIONS)])]
    for q in nodes:
        values = [round(float(m.at(q)) * factor, 9) for m in motions]
        texts = [f'{1e3 * v + 0.0:.6f}' for v in values[:3]]
        texts += [f'{v + 0.0:.9f}' for v in values[3:]]
        lines.append('\t'.join([f'{control_unit(tables.machine, axis) * q:.{digits}f}', *texts]))
    return lines


def _configuration(machine: Machine, name: str, records: int) -> str:
    chain = ''.join(machine.chain.table_side + machine.chain.target_side)
    return (
        f'compensation list: chain {chain}, workpiece_axes {len(machine.chain.table_side)}, '
        f'Interpolation GRID, file[0] {name}, file_format[0] ISG_CSV, max_records {records} or '
        f'more; lever arms and sign follow the model of the kernel: verify by measurement '
        f'before use'
    )


def _etalon(fmt: Format, request: Request) -> ExportedFiles:
    """Make the text."""
    tables = request.content.tables
    machine, gauge = tables.machine, request.content.gauge
    comments = [*request.header(fmt), *frame_words(machine), GRID_WORDS]
    if machine.squareness:
        named = ', '.join(f'[{n}]' for n in machine.squareness)
        tilts = ', '.join(TILT_WORDS[n] for n in machine.squareness)
        comments.append(f'squareness is in {named} alone and in no table: {tilts}')
    comments.append(f'zero of the tables: {gauge or "as stated by their source"}')
    lines = [f'// {" ".join(line.split())}' for line in comments]
    for name in machine.scalars:
        lines += [
            f'[{name}]',
            f'VALUE = {value_unit(name) * tables.scalar(name) + 0.0:.9f}',
        ]
    for motion in machine.motions:
        table, digits = tables.motions[motion], 6 if motion.is_translation else 9
        argument = control_unit(machine, motion.axis) * table.position + 0.0
        lines += [f'[{motion}]', 'Gridpoints = {']
        lines += [
            f'{a:.9f} {value_unit(motion) * v + 0.0:.{digits}f}'
            for a, v in zip(argument, table.value, strict=True)
        ]
        lines.append('}')
    return _exported(request, tables, lines, VARIANT_WORDS)


LACKS = 'differences between the directions of travel; uncertainties'
FORMATS = (
    Format(
        'isg',
        _isg,
        TABLE_WORDS,
        '; lengths in mm, angles in rad, right-handed',
        LACKS,
        sign_is_asked=True,
    ),
    Format(
        'etalon',
        _etalon,
        TABLE_WORDS,
        'values are errors (actual minus nominal); lengths in mm, angles in rad, right-handed',
        LACKS,
    ),
)

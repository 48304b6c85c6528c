# SPDX-License-Identifier: Apache-2.0
"""New pivot points and directions of rotary axes in the words of controls, as text to type in.

A location error moves the line of an axis: its translations move the centre, its rotations turn
the direction about the centre (docs/conventions.md). A control that knows the moved line needs no
location error any more: the numbers follow from the tables alone, their names from

- LinuxCNC, src/emc/kinematics/trtfuncs.c: x/y/z-rot-point is the centre of C, x/y/z-offset leads
  from there to the centre of the tilting axis; the tables turn right-handed, and the other way
  with conventional-directions, a pin that 2.9.0~pre1 does not have;
- SINUMERIK Operate, Commissioning Manual 6FC5397-1DP40, swivel data set: offset vectors I1 to I4
  ($TC_CARR1-6, 15-20), vectors of the axes V1, V2 ($TC_CARR7-12), reversed of axes that carry the
  workpiece.

Other controls get plain numbers: no description of their keys could be checked.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from otf_core.arrays import Array
from otf_core.exports.format import LINES, ExportedFiles, Format, Request
from otf_core.model.chain import displacement, rotations
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS, location_names
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError

TRT = {'A': ('xyzac-trt-kins', 'y'), 'B': ('xyzbc-trt-kins', 'x')}
"""Kinematics of LinuxCNC by tilting axis, and the offset it has beside z."""
TCARR = {'I1': 1, 'I2': 4, 'V1': 7, 'V2': 10, 'I3': 15, 'I4': 18}
"""First of three system variables $TC_CARRn of a vector."""


def _make(fmt: Format, request: Request) -> ExportedFiles:
    """Make the text."""
    tables = request.content.tables
    machine = tables.machine
    moved = correct_axis_lines(tables)
    lines = [f'# {line}' for line in (*request.header(fmt), *UNCHECKED)]
    lines += ['', *_numbers(machine, moved, tables)]
    for words in (_linuxcnc, _sinumerik):
        lines += ['', *words(machine, moved)]
    none = MotionTable(np.zeros(1), np.zeros(1), np.zeros(1))
    only = replace(
        tables,
        motions=dict.fromkeys(machine.motions, none),
        squareness={k: ScalarError() for k in tables.squareness},
    )
    return ExportedFiles(
        {request.name: ('\n'.join(lines) + '\n').encode()},
        lambda q: displacement(only, q),
        (
            'compare the old values with those in the control first: where they differ, add '
            'the change to what stands there; never load location errors by another file too',
            *request.unseen_words,
        ),
    )


UNCHECKED = (
    'LinuxCNC: xyzac-trt-kins was driven with such pins; xyzbc-trt-kins checked in its source',
    'SINUMERIK: names of the vectors and closure of the chain checked in the manual; their signs, '
    'and which table axis is the first, not tried on a control',
    'HEIDENHAIN, FANUC: take the numbers under [all controls]; not checked in a manual which keys '
    'and parameters hold them, nor their sign; test with one change of 0.1 mm',
)


def correct_axis_lines(tables: ErrorTables) -> Machine:
    """Machine whose rotary axes stand where the location errors say, all else unchanged."""
    machine = tables.machine
    axes = dict(machine.axes)
    for name in machine.rotary_names:
        shift, tilt = np.zeros((2, 3))
        for error in location_names(name):
            along = DIRECTIONS.index(error[0])
            (shift if along < 3 else tilt)[along % 3] = tables.scalar(error)
        direction = np.array(axes[name].direction)
        angle = float(np.linalg.norm(tilt))
        if angle > 0:
            direction = rotations(np.array([angle]), tilt / angle)[0] @ direction
        x, y, z = (float(v) for v in direction)
        cx, cy, cz = (float(v) for v in np.array(axes[name].centre) + shift)
        axes[name] = replace(axes[name], direction=(x, y, z), centre=(cx, cy, cz))
    return replace(machine, axes=axes)


def _vector(values: Array, digits: int = 6) -> str:
    return f'({", ".join(f"{v + 0.0:.{digits}f}" for v in values)})'


def _centre(machine: Machine, axis: str) -> Array:
    """Centre of an axis, mm."""
    return 1e3 * np.array(machine.axes[axis].centre)


def _direction(machine: Machine, axis: str) -> Array:
    return np.array(machine.axes[axis].direction)


def _numbers(old: Machine, new: Machine, tables: ErrorTables) -> list[str]:
    lines = ['[all controls]']
    for axis in old.rotary_names:
        names = location_names(axis)
        centre, direction = _centre(new, axis), _direction(new, axis)
        values = ', '.join(
            f'{n} {1e3 * tables.scalar(n):.6f} mm'
            if n[0] in 'XYZ'
            else f'{n} {np.degrees(tables.scalar(n)):.7f} deg'
            for n in names
        )
        lines += [
            f'location errors of {axis}: {values}',
            f'new centre of {axis} = old {_vector(_centre(old, axis))} + '
            f'{_vector(centre - _centre(old, axis))} = {_vector(centre)} mm',
            f'new direction of {axis} = old {_vector(_direction(old, axis), 9)} + '
            f'{_vector(direction - _direction(old, axis), 9)} = {_vector(direction, 9)}',
        ]
    return lines


def trunnion_pins(machine: Machine) -> dict[str, float] | None:
    """Pins of the trunnion kinematics of LinuxCNC, mm, by full name; None if not such a machine.

    The pin conventional-directions is among them, 1, where both tables turn left-handed.
    """
    order = [*machine.chain.table_side, *machine.chain.target_side]
    tilting = order[1] if len(order) > 1 else ''
    if order[:1] != ['C'] or tilting not in TRT or len(machine.rotary_names) != 2:
        return None
    senses = [
        sense
        for sense in (-1.0, 1.0)
        if all(
            np.allclose(_direction(machine, a), sense * np.eye(3)['ABC'.index(a)], atol=1e-9)
            for a in ('C', tilting)
        )
    ]
    if not senses:
        return None
    kinematics, beside = TRT[tilting]
    turn, tilt = _centre(machine, 'C'), _centre(machine, tilting)
    pins = {f'{d}-rot-point': float(v) for d, v in zip('xyz', turn, strict=True)}
    away = {f'{d}-offset': float(v) for d, v in zip('xyz', tilt - turn, strict=True)}
    pins |= {name: away[name] for name in (f'{beside}-offset', 'z-offset')}
    if senses[0] > 0:
        pins['conventional-directions'] = 1.0
    return {f'{kinematics}.{name}': value + 0.0 for name, value in pins.items()}


def _linuxcnc(old: Machine, new: Machine) -> list[str]:
    """Pins of the trunnion kinematics, where the machine is one."""
    head = '[LinuxCNC]'
    before = trunnion_pins(old)
    if before is None:
        return [
            head,
            '# xyzac-trt-kins and xyzbc-trt-kins hold a table C on a tilting table A or B, both '
            'turning right-handed (direction (0, 0, -1), (-1, 0, 0), (0, -1, 0)) or both '
            'left-handed: not this machine',
        ]
    directions = {a: old.axes[a].direction for a in old.rotary_names}
    axes = {a: replace(new.axes[a], direction=d) for a, d in directions.items()}
    after = trunnion_pins(replace(new, axes={**new.axes, **axes}))
    assert after is not None
    lines = [head, '# directions cannot be entered there: A0C, B0C and the like stay']
    for pin, value in before.items():
        if pin.endswith('directions'):
            lines += [f'# {pin}: not in LinuxCNC 2.9.0~pre1 and older', f'setp {pin} {value:.0f}']
            continue
        lines += [
            f'# old {value:.6f}, change {after[pin] - value + 0.0:+.6f} mm',
            f'setp {pin} {after[pin]:.6f}',
        ]
    return lines


def _sinumerik(old: Machine, new: Machine) -> list[str]:
    kind, before = _swivel(old)
    _, after = _swivel(new)
    first, second = _swivel_axes(old)
    lines = [
        '[SINUMERIK swivel data set]',
        f'# $TC_CARR23[n]="{kind}"; rotary axis 1: {first}, rotary axis 2: {second or "none"}; '
        'vectors from the reference point of spindle or machine at its zero; closed chain '
        '(I1, I4 close it)',
    ]
    for name, value in after.items():
        change = value - before[name]
        digits = 9 if name[0] == 'V' else 6
        lines.append(
            f'# {name}: old {_vector(before[name], digits)}, change {_vector(change, digits)}'
        )
        lines += [
            f'$TC_CARR{TCARR[name] + k}[n]={v + 0.0:.{digits}f}' for k, v in enumerate(value)
        ]
    return lines


def _swivel_axes(machine: Machine) -> tuple[str, str]:
    """Rotary axis 1 and 2: the first is the one nearer to the bed, in mixed machines the head."""
    table = [a for a in reversed(machine.chain.table_side) if a in machine.rotary_names]
    head = [a for a in machine.chain.target_side if a in machine.rotary_names]
    named = [*head, *table, '']
    return named[0], named[1]


def _swivel(machine: Machine) -> tuple[str, dict[str, Array]]:
    """Kind and vectors of the swivel data set, mm."""
    first, second = _swivel_axes(machine)
    on_table = [a in machine.chain.table_side for a in (first, second) if a]
    one = _centre(machine, first)
    two = _centre(machine, second) if second else one
    vectors = {'V1': _direction(machine, first)}
    if second:
        vectors['V2'] = _direction(machine, second)
    if all(on_table):
        # machine reference point to axis 1, to axis 2; I4 closes
        return 'P', {'I2': one, 'I3': two - one, 'I4': -two, **vectors}
    if not any(on_table):
        # tool adapter to axis 2, to axis 1; I1 closes
        return 'T', {'I1': -one, 'I2': one - two, 'I3': two, **vectors}
    return 'M', {'I1': -one, 'I2': one, 'I3': two, 'I4': -two, **vectors}


FORMATS = (
    Format(
        'pivot',
        _make,
        'centre and direction of the average line of each rotary axis',
        'new = old + location error; mm, machine coordinates with all axes at zero, without the '
        'target offset; changes stand beside the new values',
        'error motions of the axes, squareness; orientation is corrected only where a control '
        'takes the directions',
        holds=LINES,
    ),
)

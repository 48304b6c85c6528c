# SPDX-License-Identifier: Apache-2.0
"""Programs of a plan for a machine with rotary axes: one per part, and one with TCP on.

With TCP off the positions are those of the axes, so what the control knows of its rotary axes does
not enter, and the nominal path is the one that is published. Every block has its time: a feed in
mm/min means nothing where rotary axes move. The reflector is moved by hand between two parts,
while the program of the next one waits. The program with TCP on verifies: the control holds the
reflector at one place of the workpiece while the rotary axes turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from otf_core.arrays import Array
from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.axis_path import AxisPath, driven_through, seconds_of_legs
from otf_core.model.joints import Sight
from otf_core.model.machine import TOOL, Machine
from otf_core.planning.nc.dialect import AxisMove, Dialect, comment_lines
from otf_core.planning.rotary_paths import PlannedPart, courses, creeps

INCREMENT = 1e-3
"""mm and degrees; resolution of the positions in a program."""
MOST_PER_MINUTE, LEAST_PER_MINUTE = 9999.0, 0.01
"""1/min; inverse times that all controls take."""
LEAST_DWELL = 1e-3
"""s; controls take no shorter ones."""
APPROACH = 20.0
"""s for a move to the start of a part."""


def program_units(machine: Machine) -> Array:
    """Shape (k,); mm per m and degrees per rad."""
    axes = [machine.axes[a] for a in machine.axis_names]
    return np.array([np.degrees(1.0) if a.rotary else 1e3 for a in axes])


def on_axis_increment(machine: Machine, part: PlannedPart) -> PlannedPart:
    """Round the corners of a part to what a program can say, inside the axis ranges."""
    scale = program_units(machine) / INCREMENT
    low, high = machine.lower * scale, machine.upper * scale
    inner = np.ceil(low - 1e-3), np.floor(high + 1e-3)
    q = np.clip(np.rint(part.path.positions * scale), *inner) / scale + 0.0  # no -0.0
    path = AxisPath(machine.axis_names, q, part.path.target)
    return replace(part, path=path.of(machine))


def axis_moves(machine: Machine, part: PlannedPart, feed: float) -> list[AxisMove]:
    """Blocks of a part, one per leg, in mm, degrees and s.

    Parameters
    ----------
    feed : float
        m/s, of the linear axes.
    """
    q = part.path.positions
    at = q * program_units(machine)
    seconds = seconds_of_legs(machine, q, feed)
    through = np.append(driven_through(machine, q), False)
    moves = []
    for k in range(len(q) - 1):
        through_here = bool(through[k]) and not part.stops
        moves.append(_move(machine, at[k], at[k + 1], float(seconds[k]), stop=not through_here))
    return moves


def _move(machine: Machine, start: Array, end: Array, seconds: float, *, stop: bool) -> AxisMove:
    names = machine.axis_names
    by = {a: v for a, v in zip(names, (end - start).tolist(), strict=True) if abs(v) > 1e-6}
    rotary = np.array([machine.axes[a].rotary for a in names])
    step = end - start
    linear = float(np.linalg.norm(step[~rotary]))
    return AxisMove(
        dict(zip(names, end.tolist(), strict=True)),
        by,
        tuple(a for a in by if machine.axes[a].endless),
        seconds,
        linear if linear > 0.0 else float(np.linalg.norm(step[rotary])),
        stop,
    )


def part_program(
    dialect: Dialect,
    machine: Machine,
    part: PlannedPart,
    number: int,
    config: PlannerConfig,
    header: Sequence[str],
) -> str:
    """Program of one part, TCP off: approach, stop for the reflector and the recording, path.

    It stands at both ends, so that the recording shows the noise of the tracker.

    Parameters
    ----------
    part : PlannedPart
        Corners on the increment, see ``on_axis_increment``.
    number : int
        Of the part, from 1.
    header : sequence of str
        Comments.

    Raises
    ------
    ConfigError
        If a block takes longer or less than controls take.
    """
    moves = axis_moves(machine, part, config.feed)
    _check(dialect, moves)
    notes = [
        *header,
        f'part {number}: reflector {part.path.target}: {part.words}',
        'TCP off: positions of the axes; X Y Z in mm, angles in degrees, a time for every block',
        *([f'not confirmed by a manual: {dialect.unchecked}'] if dialect.unchecked else []),
    ]
    lines = dialect.begin_axes(_comments(notes), number, False)
    lines += _approach(dialect, machine, part)
    lines += dialect.say(f'part {number}: {_put_reflector(machine, part)}, lock the beam, record')
    lines += [*dialect.wait(), *_stand(dialect, config.end_dwell)]
    for k, move in enumerate(moves, start=1):
        lines += dialect.move_axes(move, False)
        if move.stop:
            at_end = k == len(moves)
            lines += _stand(dialect, config.end_dwell if at_end else part.halt(config))
    lines += dialect.say(f'part {number} is done: stop recording, break the beam')
    return '\n'.join(dialect.finished([*lines, *dialect.wait(), *dialect.end_axes(False)])) + '\n'


def _put_reflector(machine: Machine, part: PlannedPart) -> str:
    """What the operator does with the reflector before a part."""
    name = part.path.target
    nest = machine.targets[name].nest
    if nest in ('', name):
        return f'put the reflector at {name}' + (', turned to the tracker' if nest else '')
    return f'turn the reflector at {nest} to the tracker ({name})'


def _stand(dialect: Dialect, seconds: float) -> list[str]:
    if seconds > dialect.longest_dwell:
        raise ConfigError(
            f'{dialect.name}: a dwell of {seconds:g} s; the longest is {dialect.longest_dwell:g} s'
        )
    return dialect.dwell(seconds) if seconds >= LEAST_DWELL else []


def _comments(notes: Sequence[str]) -> list[str]:
    return [line for text in notes for line in comment_lines(text)]


def _approach(dialect: Dialect, machine: Machine, part: PlannedPart) -> list[str]:
    """Z to the top of the part, the other axes to its start, then Z."""
    q = part.path.positions * program_units(machine)
    z = machine.column('Z')
    start, top = dict(zip(machine.axis_names, q[0].tolist(), strict=True)), float(q[:, z].max())
    others = {a: v for a, v in start.items() if a != 'Z'}
    lines = [dialect.comment('APPROACH: Z TO THE TOP OF THE PART, THEN TO ITS START')]
    for to in ({'Z': top}, others, {'Z': start['Z']}):
        lines += dialect.move_axes(AxisMove(to, {}, (), APPROACH, APPROACH * 20.0, True), False)
    return lines


def _check(dialect: Dialect, moves: Sequence[AxisMove]) -> None:
    rates = [m.per_minute for m in moves]
    if max(rates) > MOST_PER_MINUTE or min(rates) < LEAST_PER_MINUTE:
        raise ConfigError(
            f'{dialect.name}: blocks take {60 / max(rates):.3g} s to {60 / min(rates):.3g} s; '
            f'controls take {60 / MOST_PER_MINUTE:.3g} s to {60 / LEAST_PER_MINUTE:.3g} s: give '
            f'another feed'
        )


def verification_part(machine: Machine) -> PlannedPart | None:
    """Turn every rotary axis while the linear axes hold the reflector; None if out of reach.

    It is driven with TCP on; its corners are where the axes are then, 1 degree apart.
    """
    table = replace(machine, tracker=replace(machine.tracker, link='w'))
    chains = []
    for axis in machine.rotary_names:
        with suppress(ConfigError):  # the linear axes do not reach
            chains.append(creeps(table, {axis: courses(machine, axis)}, TOOL, 0.0)[0])
    if not chains:
        return None
    path = AxisPath(machine.axis_names, np.concatenate(chains), TOOL).of(machine)
    return on_axis_increment(machine, PlannedPart(path, 0.0, 'TCP on'))


def verification_program(
    dialect: Dialect, machine: Machine, part: PlannedPart, number: int, header: Sequence[str]
) -> str:
    """Program with TCP on: the reflector stays at its place of the workpiece, the axes turn.

    Parameters
    ----------
    part : PlannedPart
        Of ``verification_part``.
    """
    notes = [
        *header,
        'verification, TCP on: the reflector in the spindle stays at one place of the workpiece',
        'workpiece zero: machine zero with all axes at zero; tool length: that of target-offset',
        *([f'not confirmed by a manual: {dialect.unchecked}'] if dialect.unchecked else []),
    ]
    q = part.path.positions
    places = 1e3 * Sight.of_tool(machine).nominal(q)
    turned = q * program_units(machine)
    seconds = seconds_of_legs(machine, q, 0.1)
    lines = dialect.begin_axes(_comments(notes), number, True)
    rotary = machine.rotary_names
    at = [_in_workpiece(machine, p, t) for p, t in zip(places, turned, strict=True)]
    lines += dialect.move_axes(AxisMove(at[0], {}, (), APPROACH, APPROACH * 20.0, True), True)
    lines += dialect.say('put the reflector into the spindle, lock the beam, record')
    lines += dialect.wait()
    for k in range(1, len(q)):
        by = {a: at[k][a] - at[k - 1][a] for a in at[k] if abs(at[k][a] - at[k - 1][a]) > 5e-4}
        endless = tuple(a for a in by if a in rotary and machine.axes[a].endless)
        size = float(np.linalg.norm([by.get(a, 0.0) for a in rotary]))
        last = k == len(q) - 1
        move = AxisMove(at[k], by, endless, float(seconds[k - 1]), max(size, 1.0), last)
        lines += dialect.move_axes(move, True)
    return '\n'.join(dialect.finished([*lines, *dialect.end_axes(True)])) + '\n'


def _in_workpiece(machine: Machine, place: Array, turned: Array) -> Mapping[str, float]:
    """Words of a block with TCP on: place of the reflector in mm, rotary axes in degrees."""
    position = dict(zip('XYZ', np.round(place, 3).tolist(), strict=True))
    return position | {a: float(turned[machine.column(a)]) for a in machine.rotary_names}

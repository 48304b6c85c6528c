# SPDX-License-Identifier: Apache-2.0
"""Programs of a plan in a dialect: one per part, and with rotary axes one with TCP on.

A program drives to the start above the part, waits there for reflector and recording, drives the
part, and stands at both ends, so that the recording shows the noise of the tracker. With TCP off
the positions are those of the axes, so what the control knows of its rotary axes does not enter,
and the nominal path is the one that is published. The program with TCP on verifies: the control
holds the reflector at one place of the workpiece while the rotary axes turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.axis_path import seconds_of_legs
from otf_core.model.chain import Sight
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES
from otf_core.model.plan import Part, Plan
from otf_core.planning.nc.dialect import LEAST_DWELL, Dialect, Move, Program, comment_lines

INCREMENT = 1e-3
"""mm and degrees; resolution of the positions in a program."""
LARGEST_POSITION = 99999.999
"""mm; more than five digits before the decimal point are refused."""
MOST_PER_MINUTE, LEAST_PER_MINUTE = 9999.0, 0.01
"""1/min; inverse times that all controls take."""
APPROACH, APPROACH_FEED = 20.0, 1200.0
"""s, and mm/min, for a move to the start of a part where blocks have times."""
NO_TRAVEL = 0.01
"""mm; linear axes that travel less stand, as far as the feed of a block goes."""


def program_units(machine: Machine) -> Array:
    """Shape (k,); mm per m and degrees per rad."""
    axes = [machine.axes[a] for a in machine.axis_names]
    return np.array([np.degrees(1.0) if a.rotary else 1e3 for a in axes])


def on_increment(machine: Machine, part: Part) -> Part:
    """Round the corners of a part to what a program can say, inside the axis ranges."""
    scale = program_units(machine) / INCREMENT
    inner = np.ceil(machine.lower * scale - 1e-3), np.floor(machine.upper * scale + 1e-3)
    q = np.clip(np.rint(part.path.positions * scale), *inner) / scale + 0.0  # no -0.0
    return replace(part, path=replace(part.path, positions=q)).of(machine)


def on_increments(machine: Machine, parts: Sequence[Part]) -> Plan:
    """Plan of parts at positions that a program can state."""
    return Plan(tuple(on_increment(machine, part) for part in parts))


def _moves(machine: Machine, names: Sequence[str], at: Array, part: Part) -> list[Move]:
    """Blocks between rows (n, k) of words, mm and degrees, that are driven as a part is."""
    halts, step = part.halts(machine), np.diff(at, axis=0)
    seconds = seconds_of_legs(machine, part.path.positions, part.feed)
    rotary = np.array([a in machine.rotary_names for a in names])
    linear, turned = (np.linalg.norm(step[:, own], axis=1) for own in (~rotary, rotary))
    moves = []
    for k, row in enumerate(step.tolist()):
        by = {a: v for a, v in zip(names, row, strict=True) if abs(v) > 0.5 * INCREMENT}
        moves.append(Move(
            dict(zip(names, at[k + 1].tolist(), strict=True)), by,
            tuple(a for a in by if machine.axes[a].endless), float(seconds[k]),
            float(linear[k] if linear[k] > NO_TRAVEL else max(turned[k], NO_TRAVEL)),
            bool(halts[k + 1]), float(part.dwell[k + 1]),
        ))  # fmt: skip
    return moves


def _whole(
    dialect: Dialect, program: Program, notes: Sequence[str], approach: list[str], put: str,
    lines: Sequence[str],
) -> str:  # fmt: skip
    """A program: head, approach, stop for reflector and recording, its blocks, end."""
    if program.turns and dialect.unchecked:
        notes = [*notes, f'not confirmed by a manual: {dialect.unchecked}']
    whole = dialect.begin([line for text in notes for line in comment_lines(text)], program)
    whole += [*approach, *dialect.say(f'{put}, lock the beam, record'), dialect.stop_word]
    return '\n'.join(dialect.finished([*whole, *lines, *dialect.end(program)])) + '\n'


def part_program(
    dialect: Dialect, machine: Machine, part: Part, number: int, header: Sequence[str]
) -> str:
    """Program of one part, TCP off: approach, stop for reflector and recording, the part.

    Parameters
    ----------
    part : Part
        Corners on the increment, see ``on_increment``.
    number : int
        Of the part, from 1.
    header : sequence of str
        Comments, each of one line or more.

    Raises
    ------
    ConfigError
        If the dialect cannot express the part.
    """
    part = part.of(machine)
    program, at = Program(number, bool(machine.rotary_names)), part.path.positions
    at = np.round(at * program_units(machine), 6)
    moves = _moves(machine, machine.axis_names, at, part)
    _check(dialect, machine, part, moves, program)
    turning = [
        f'part {number}: reflector {part.target}: {part.words}',
        'TCP off: positions of the axes; X Y Z in mm, angles in degrees, a time for every block',
    ]
    lines = _stand(dialect, float(part.dwell[0]))
    for move in moves:
        lines += [*dialect.move(move, program), *_stand(dialect, move.dwell)]
    return _whole(
        dialect, program, [*header, *(turning if program.turns else [])],
        _approach(dialect, machine, at, moves, program),
        f'part {number}: {_put_reflector(machine, part)}', lines,
    )  # fmt: skip


def _put_reflector(machine: Machine, part: Part) -> str:
    """What the operator does with the reflector before a part."""
    nest = machine.targets[part.target].nest
    if nest in ('', part.target):
        turned = ', turned to the tracker' if nest else ''
        return f'put the reflector at {part.target}{turned}'
    return f'turn the reflector at {nest} to the tracker ({part.target})'


def _stand(dialect: Dialect, seconds: float) -> list[str]:
    return dialect.dwell(seconds) if seconds >= LEAST_DWELL else []


def _approach(
    dialect: Dialect, machine: Machine, at: Array, moves: Sequence[Move], program: Program
) -> list[str]:
    """Z to the top of the part, the other axes to its start, then Z; at the slowest feed."""
    start = dict(zip(machine.axis_names, at[0].tolist(), strict=True))
    stages = [start]
    if 'Z' in start and len(start) > 1:
        others = {a: v for a, v in start.items() if a != 'Z'}
        stages = [{'Z': float(at[:, machine.column('Z')].max())}, others, {'Z': start['Z']}]
    feed = APPROACH_FEED if program.turns else min(m.feed for m in moves)
    lines = [dialect.comment('APPROACH: Z TO THE TOP OF THE PART, THEN TO ITS START')]
    for to in stages:
        way = Move(to, {}, (), APPROACH, feed * APPROACH / 60.0)
        lines += dialect.move(way, program)
    return lines


def _check(
    dialect: Dialect, machine: Machine, part: Part, moves: Sequence[Move], program: Program
) -> None:
    at = part.path.positions * program_units(machine)
    linear = [k for k, a in enumerate(machine.axis_names) if not machine.axes[a].rotary]
    rates, longest = [m.per_minute for m in moves], float(part.dwell.max())
    if np.abs(at - np.rint(at / INCREMENT) * INCREMENT).max() > 1e-6:
        problem = f'the path has positions between the increments of {INCREMENT:g} mm'
    elif np.abs(at[:, linear]).max(initial=0.0) > LARGEST_POSITION:
        problem = f'positions beyond {LARGEST_POSITION:.3f} mm'
    elif program.turns and (max(rates) > MOST_PER_MINUTE or min(rates) < LEAST_PER_MINUTE):
        problem = (
            f'blocks take {60 / max(rates):.3g} s to {60 / min(rates):.3g} s; controls take '
            f'{60 / MOST_PER_MINUTE:.3g} s to {60 / LEAST_PER_MINUTE:.3g} s: give another feed'
        )
    elif not program.turns and min(m.feed for m in moves) < 1:
        problem = f'a feed of {60e3 * part.feed.min():.3g} mm/min rounds to 0'
    elif longest > dialect.longest_dwell:
        problem = f'a dwell of {longest:g} s; the longest is {dialect.longest_dwell:g} s'
    else:
        return
    raise ConfigError(f'{dialect.name}: {problem}')


def verification_program(
    dialect: Dialect, machine: Machine, part: Part, number: int, header: Sequence[str]
) -> str:
    """Program with TCP on: the reflector stays at its place of the workpiece, the axes turn.

    Parameters
    ----------
    part : Part
        Of ``chains.verification_part``.
    """
    notes = [
        *header,
        'verification, TCP on: the reflector in the spindle stays at one place of the workpiece',
        'workpiece zero: machine zero with all axes at zero; tool length: that of target-offset',
    ]
    program, q = Program(number, turns=True, tcp=True), part.path.positions
    rotary, names = machine.rotary_names, (*AXES, *machine.rotary_names)
    turned = (q * program_units(machine))[:, [machine.column(a) for a in rotary]]
    at = np.hstack([np.round(1e3 * Sight.of_tool(machine).nominal(q), 3), turned])
    moves = _moves(machine, names, at, part)
    start = Move(dict(zip(names, at[0].tolist(), strict=True)), {}, (), APPROACH, APPROACH * 20.0)
    lines = [
        line
        for k, move in enumerate(moves, start=1)
        for line in dialect.move(replace(move, stop=k == len(moves), dwell=0.0), program)
    ]
    put = 'put the reflector into the spindle'
    return _whole(dialect, program, notes, dialect.move(start, program), put, lines)


def programs_of(
    dialect: Dialect,
    machine: Machine,
    plan: Plan,
    header: Sequence[str],
    verification: Part | None = None,
) -> dict[str, str]:
    """Programs by file name: one per part, and the ``verification`` with TCP on.

    Raises
    ------
    ConfigError
        If the dialect cannot express the plan.
    """
    texts = {
        dialect.file_of(k): part_program(dialect, machine, part, k, header)
        for k, part in enumerate(plan.parts, start=1)
    }
    if verification is not None:
        number = len(plan.parts) + 1
        text = verification_program(dialect, machine, verification, number, header)
        texts[dialect.file_of(number)] = text
    return texts

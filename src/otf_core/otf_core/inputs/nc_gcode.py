# SPDX-License-Identifier: Apache-2.0
"""Reads the moves of G-code (DIN 66025, ISO 6983) of FANUC, SINUMERIK, LinuxCNC, TwinCAT.

Whatever may move an axis otherwise than along lines and arcs of X, Y, Z, or shifts what positions
refer to, is refused by its line and word; so is any word that is not known.
Sources: those of the dialects in ``planning/nc``; LinuxCNC 2.9, G-code reference (arcs, planes,
G90.1, G53); ISO 6983-1 (meaning of the letters).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from decimal import Decimal
from typing import NoReturn

from otf_core.inputs.nc_path import MACHINE, DrivenPath, Position, refuse

NUMBER = r'[-+]?\s*(?:\d+\.?\d*|\.\d+)'
TOKEN = re.compile(
    rf'(?P<axis>[XYZIJK])\s*=\s*(?P<mode>IC|AC)\s*\(\s*(?P<moved>{NUMBER})\s*\)'
    rf'|CR\s*=\s*(?P<radius>{NUMBER})'
    r'|(?P<name>[A-Z_]{2,}[A-Z0-9_]*)'
    rf'|(?P<letter>[A-Z])\s*=?\s*(?P<value>{NUMBER})'
)
SPINDLE = re.compile(r'\b[SM]\d+\s*=\s*\d+\.?\d*')
"""Speed or direction of a numbered spindle (SINUMERIK)."""
LONGEST_NUMBER = 30
"""Characters."""
INCH = Decimal('0.0254')
MILLIMETRE = Decimal('0.001')
PLANES = {'17': 'XY', '18': 'ZX', '19': 'YZ'}
UNITS = {
    '20': INCH,
    '70': INCH,
    '700': INCH,
    '21': MILLIMETRE,
    '71': MILLIMETRE,
    '710': MILLIMETRE,
}
OFFSETS = re.compile(r'5[4-9](\.\d+)?|50[5-9]|5[1-9]\d')
HARMLESS_G = frozenset((
    '8', '9', '15', '23', '40', '49', '50', '60', '61', '61.1', '62', '64', '69', '80', '93', '94',
    '95', '96', '97', '98', '99', '187', '359', '360', '450', '451', '601', '602', '603', '641',
    '642', '643', '644', '645',
))  # fmt: skip
"""How exactly and how fast it is driven, and what switches corrections off."""
WHY = {
    '10': 'sets offsets', '16': 'switches to polar coordinates', '31': 'probes', '38': 'probes',
    '33': 'cuts threads', '41': 'switches cutter compensation on',
    '42': 'switches cutter compensation on',
    '43': 'switches a tool length offset on', '44': 'switches a tool length offset on',
    '51': 'scales positions', '52': 'shifts the coordinates', '65': 'calls a macro',
    '66': 'calls a macro', '68': 'rotates the coordinates', '92': 'shifts the coordinates',
    '5': 'drives a spline', '6': 'drives a spline', '7': 'programs diameters',
}  # fmt: skip
CYCLES = frozenset(('73', '74', '76', *map(str, range(81, 90))))
HARMLESS_NAMES = frozenset((
    'FFWON', 'FFWOF', 'SOFT', 'BRISK', 'DRIVE', 'STOPRE', 'SUPA', 'DIAMOF', 'COMPOF', 'CFC',
    'CFTCP', 'CFIN', 'MSG',
))  # fmt: skip
STOPS, ENDS = ('0', '1', '60'), ('2', '30', '17')
REFUSED_M = {
    '96': 'calls a subprogram', '97': 'calls a subprogram', '98': 'calls a subprogram',
    '99': 'repeats the program or returns from a subprogram',
    '128': 'switches tool centre point control on',
}  # fmt: skip
HARMLESS_LETTERS = 'FSTNO'
CALLS = re.compile(
    r'CALL|CYCLE|POCKET|SLOT|HOLES|GOTO|IF|ELSE|ENDIF|WHILE|FOR|REPEAT|LOOP|DO|SUB|DEF'
)
FRAMES = re.compile(r'A?(TRANS|ROT|SCALE|MIRROR|ROTS)|CYCLE800|TRAORI|TRAFOOF|TRANSMIT|TRACYL')


@dataclass
class _Block:
    """Words of a block."""

    g: list[str] = field(default_factory=list)
    m: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    axes: dict[str, tuple[Decimal, str]] = field(default_factory=dict)
    centre: dict[str, tuple[Decimal, str]] = field(default_factory=dict)
    radius: Decimal | None = None
    others: list[tuple[str, Decimal, str]] = field(default_factory=list)


class GCode:
    """State of a control that reads G-code.

    Parameters
    ----------
    path : DrivenPath
        Filled with the moves.
    """

    def __init__(self, path: DrivenPath) -> None:
        self._path, self._where = path, path.where
        self._motion, self._plane, self._unit = '1', 'XY', MILLIMETRE
        self._absolute, self._centre_absolute = True, False
        self._frame = 'the active work offset'

    def read(self, lines: Iterable[str]) -> None:
        """Read lines up to the end of the program."""
        for number, line in enumerate(lines, start=1):
            text = without_comments(line.upper())
            if text is None:
                refuse(self._where, number, line.strip(), 'is a comment that is not closed')
            text = text.strip().rstrip('*').strip()
            if text.startswith('%'):
                unit = re.search(r'\bG(7[01])\s*$', text)  # HEIDENHAIN ISO: %NAME G71 *
                self._unit = UNITS[unit[1]] if unit else self._unit
                continue
            skipped = text.startswith('/')
            text = re.sub(r'^/?\s*(?:[N:]\s*\d+)?\s*/?', '', text).strip()
            text = SPINDLE.sub('', text).strip()
            if not text or text.startswith('%'):
                continue
            block = self._parsed(number, text)
            if skipped and (block.axes or set(block.g) & {'0', '1', '2', '3'}):
                refuse(self._where, number, line.strip(), 'is skipped or not by a switch')
            if not skipped and self._run(number, text, block):
                return

    def _parsed(self, number: int, text: str) -> _Block:
        block, at = _Block(), 0
        while at < len(text):
            if text[at].isspace():
                at += 1
                continue
            match = TOKEN.match(text, at) or self._unreadable(number, text[at:])
            at = match.end()
            while at < len(text) and text[at].isspace():
                at += 1
            if at < len(text) and text[at] in '*/[#=(),"\'':  # 2*R1, X[#1], CYCLE81(...)
                self._unreadable(number, text[match.start() :])
            self._sort(number, block, match)
        return block

    def _unreadable(self, number: int, text: str) -> NoReturn:
        word = text.split()[0]
        why = 'is no word with a number'
        if re.search(r'[#\[\]]|[A-Z_]*\s*=\s*[A-Z]|^R\d+\s*=|\$', text):
            why = 'holds a variable, an expression or a command'
        elif CALLS.match(text) or FRAMES.match(text):
            why = 'is a cycle, a call or a command'
        refuse(self._where, number, word, why)

    def _sort(self, number: int, block: _Block, match: re.Match[str]) -> None:
        word = match[0]
        if match['name']:
            block.names.append(match['name'])
            return
        letter = match['axis'] or ('R' if match['radius'] else match['letter'])
        digits = (match['moved'] or match['radius'] or match['value']).replace(' ', '')
        if len(digits) > LONGEST_NUMBER:
            refuse(self._where, number, word, 'is a number of too many digits')
        value, mode = Decimal(digits), match['mode'] or ''
        if letter == 'G':
            block.g.append(_code(value))
        elif letter == 'M':
            block.m.append(_code(value))
        elif letter in 'XYZ':
            if letter in block.axes:
                refuse(self._where, number, word, f'is a second {letter} in its block')
            block.axes[letter] = value, mode
        elif letter in 'IJK':
            block.centre[letter] = value, mode
        elif letter == 'R':
            block.radius = value
        else:
            block.others.append((letter, value, word))

    def _run(self, number: int, text: str, block: _Block) -> bool:
        """Run a block; True at the end of the program."""
        self._check_names(number, block)
        for code in block.m:
            if code in REFUSED_M:
                refuse(self._where, number, f'M{code}', REFUSED_M[code])
        dwells = '4' in block.g
        home = {'28', '30'} & set(block.g)
        self._modal(number, block)
        self._check_others(number, block, dwells=dwells)
        if not dwells:
            self._move(number, text, block, home=bool(home))
        if any(code in STOPS for code in block.m):
            self._path.stop()
        return any(code in ENDS for code in block.m)

    def _check_names(self, number: int, block: _Block) -> None:
        for name in block.names:
            if name in HARMLESS_NAMES:
                continue
            why = 'is not known'
            if FRAMES.match(name):
                why = 'shifts, turns or scales the coordinates, or transforms them'
            elif CALLS.match(name):
                why = 'is a cycle, a call or a command'
            refuse(self._where, number, name, why)

    def _modal(self, number: int, block: _Block) -> None:
        """Take the preparatory functions of a block."""
        for code in block.g:
            if code in ('0', '1', '2', '3'):
                self._motion = code
            elif code in PLANES:
                self._plane = PLANES[code]
            elif code in UNITS:
                self._unit = UNITS[code]
            elif code in ('90', '91'):
                self._absolute = code == '90'
            elif code in ('90.1', '91.1'):
                self._centre_absolute = code == '90.1'
            elif code == '500' or (code == '53' and not block.axes):  # TwinCAT: G53 is modal
                self._frame = MACHINE
            elif OFFSETS.fullmatch(code):
                self._frame = f'G{code}'
            elif code == '52' and not any(value for value, _ in block.axes.values()):
                block.axes.clear()
            elif code == '50' and block.axes:
                refuse(self._where, number, 'G50', 'scales positions or sets coordinates')
            elif code in ('4', '28', '30', '53', '153') or code in HARMLESS_G:
                continue
            else:
                family = code.split('.')[0]
                why = 'is a cycle' if family in CYCLES else WHY.get(family, 'is not known')
                refuse(self._where, number, f'G{code}', why)

    def _check_others(self, number: int, block: _Block, *, dwells: bool) -> None:
        """Refuse words that may move or shift anything."""
        parameters = dwells or bool({'64', '8', '187', '642'} & set(block.g))
        for letter, value, word in block.others:
            if letter in HARMLESS_LETTERS or (letter in 'PQUHE' and parameters):
                continue
            if letter in 'DH' and not value:
                continue
            if letter == 'P' and value == 1 and self._motion in '23':
                continue  # turns of an arc
            if letter in 'ABCUVW':
                if value or not self._absolute:
                    refuse(self._where, number, word, 'moves an axis that is none of X, Y, Z')
                continue
            why = {
                'D': 'takes a tool offset', 'H': 'takes a tool length offset',
                'L': 'calls a subprogram',
            }.get(letter, 'is not known here')  # fmt: skip
            refuse(self._where, number, word, why)
        if block.radius is not None and self._motion not in '23' and not dwells:
            refuse(self._where, number, f'R{block.radius}', 'belongs to no arc')

    def _move(self, number: int, text: str, block: _Block, *, home: bool) -> None:
        machine = bool({'53', '153'} & set(block.g)) or 'SUPA' in block.names
        frame = MACHINE if machine else self._frame
        word = text if len(text) <= 40 else f'{text[:37]}...'
        if home:
            gone: Position = dict.fromkeys(block.axes or 'XYZ')
            self._path.line_to(number, word, gone, frame)
            return
        arc = self._motion in '23'
        if not block.axes and not (arc and (block.centre or block.radius is not None)):
            return
        if machine and not self._absolute:
            refuse(self._where, number, word, 'names machine coordinates in increments')
        goal: Position = {a: self._goal(a, *given) for a, given in block.axes.items()}
        if not arc:
            if block.centre:
                refuse(self._where, number, word, 'has a centre, but the motion is a line')
            before = dict(self._path.at)
            moved = [a for a, value in goal.items() if value != before[a]]
            self._path.slanted_rapids += self._motion == '0' and len(moved) > 1
            self._path.line_to(number, word, goal, frame)
            return
        centre = None
        if block.centre:
            centre = self._centre(number, word, block)
        elif block.radius is None:
            refuse(self._where, number, word, 'is an arc without centre (I, J, K) and radius (R)')
        radius = None if block.radius is None else block.radius * self._unit
        self._path.arc_to(
            number, word, goal, frame, self._plane, centre, radius, clockwise=self._motion == '2'
        )

    def _goal(self, axis: str, value: Decimal, mode: str) -> Decimal | None:
        """Where an axis goes, m; None: from where it is not known by so much."""
        if mode == 'AC' or (self._absolute and not mode):
            return value * self._unit
        before = self._path.at[axis]
        return None if before is None else before + value * self._unit

    def _centre(self, number: int, word: str, block: _Block) -> dict[str, Decimal] | None:
        of_axis = dict(zip('XYZ', 'IJK', strict=True))
        letters = [of_axis[axis] for axis in self._plane]
        wrong = [letter for letter in block.centre if letter not in letters]
        if any(block.centre[letter][0] for letter in wrong):
            refuse(self._where, number, word, f'has {wrong[0]} in the plane {self._plane}')
        found = {}
        for axis, letter in zip(self._plane, letters, strict=True):
            value, mode = block.centre.get(letter, (Decimal(0), ''))
            start = self._path.at[axis]
            absolute = mode == 'AC' or (self._centre_absolute and not mode)
            if absolute and letter not in block.centre:
                refuse(self._where, number, word, f'lacks {letter} of its centre (G90.1)')
            found[axis] = value * self._unit + (Decimal(0) if absolute else start or Decimal(0))
        return found


def _code(value: Decimal) -> str:
    """Number of a G or M word as it is spoken of: 1 for 01 and 1.0."""
    text = f'{value:f}'
    return (text.rstrip('0').rstrip('.') if '.' in text else text).lstrip('0+') or '0'


def without_comments(line: str) -> str | None:
    """Text of a block without comments in brackets and behind a semicolon; None: not closed."""
    kept: list[str] = []
    depth = at = 0
    while at < len(line):
        sign = line[at]
        if depth == 0 and sign == ';':
            break
        if depth == 0 and sign == '"':  # what SINUMERIK shows: MSG("...")
            at = line.find('"', at + 1)
            if at < 0:
                return None
            while kept and kept[-1] in ' (':
                kept.pop()
            at += len(line[at + 1 :]) - len(line[at + 1 :].lstrip(' )'))
            kept.append(' ')
        elif sign == '(' and (depth or not _calls(line[max(at - 30, 0) : at])):
            depth += 1
        elif sign == ')' and depth:
            depth -= 1
            kept.append(' ')
        elif not depth:
            kept.append(sign)
        at += 1
    return None if depth else ''.join(kept)


def _calls(before: str) -> bool:
    """Tell whether a bracket belongs to the word before it, as in X=IC(10) or MSG("...")."""
    return bool(re.search(r'(?:^|[\s=])[A-Z_]{2,}\d*$', before))

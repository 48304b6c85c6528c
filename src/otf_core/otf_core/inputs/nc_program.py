# SPDX-License-Identifier: Apache-2.0
"""NC programs as paths: G-code (DIN 66025, ISO 6983) and HEIDENHAIN Klartext."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import NoReturn

from otf_core.arrays import Array
from otf_core.files.message_text import shortened
from otf_core.files.writing import unreadable
from otf_core.inputs.nc_path import CHORD, MACHINE, DrivenPath, Position

# Reads the moves of G-code (DIN 66025, ISO 6983) of FANUC, SINUMERIK, LinuxCNC, TwinCAT.
#
# Whatever may move an axis otherwise than along lines and arcs of X, Y, Z, or shifts what
# positions refer to, is refused by its line and word; so is any word that is not known. Sources:
# those of the dialects in ``planning/nc``; LinuxCNC 2.9, G-code reference (arcs, planes, G90.1,
# G53); ISO 6983-1 (meaning of the letters).

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
        self._path = path
        self._motion, self._plane, self._unit = '1', 'XY', MILLIMETRE
        self._absolute, self._centre_absolute = True, False
        self._frame = 'the active work offset'

    def read(self, lines: Iterable[str]) -> None:
        """Read lines up to the end of the program."""
        for number, line in enumerate(lines, start=1):
            text = without_comments(line.upper())
            self._path.block = number, line.strip()
            if text is None:
                self._path.refuse('is a comment that is not closed')
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
            self._path.block = number, shortened(text, 40)
            block = self._parsed(text)
            if skipped and (block.axes or set(block.g) & {'0', '1', '2', '3'}):
                self._path.refuse('is skipped or executed depending on a switch')
            if not skipped and self._run(block):
                return

    def _parsed(self, text: str) -> _Block:
        block, at = _Block(), 0
        while at < len(text):
            if text[at].isspace():
                at += 1
                continue
            match = TOKEN.match(text, at) or self._unreadable(text[at:])
            at = match.end()
            while at < len(text) and text[at].isspace():
                at += 1
            if at < len(text) and text[at] in '*/[#=(),"\'':  # 2*R1, X[#1], CYCLE81(...)
                self._unreadable(text[match.start() :])
            self._sort(block, match)
        return block

    def _unreadable(self, text: str) -> NoReturn:
        word = text.split()[0]
        why = 'is not a word with a number'
        if re.search(r'[#\[\]]|[A-Z_]*\s*=\s*[A-Z]|^R\d+\s*=|\$', text):
            why = 'holds a variable, an expression or a command'
        elif CALLS.match(text) or FRAMES.match(text):
            why = 'is a cycle, a call or a command'
        self._path.refuse(why, word)

    def _sort(self, block: _Block, match: re.Match[str]) -> None:
        word = match[0]
        if match['name']:
            block.names.append(match['name'])
            return
        letter = match['axis'] or ('R' if match['radius'] else match['letter'])
        digits = (match['moved'] or match['radius'] or match['value']).replace(' ', '')
        if len(digits) > LONGEST_NUMBER:
            self._path.refuse('has too many digits', word)
        value, mode = Decimal(digits), match['mode'] or ''
        if letter == 'G':
            block.g.append(_code(value))
        elif letter == 'M':
            block.m.append(_code(value))
        elif letter in 'XYZ':
            if letter in block.axes:
                self._path.refuse(f'is a second {letter} in its block', word)
            block.axes[letter] = value, mode
        elif letter in 'IJK':
            block.centre[letter] = value, mode
        elif letter == 'R':
            block.radius = value
        else:
            block.others.append((letter, value, word))

    def _run(self, block: _Block) -> bool:
        """Run a block; True at the end of the program."""
        self._check_names(block)
        for code in block.m:
            if code in REFUSED_M:
                self._path.refuse(REFUSED_M[code], f'M{code}')
        dwells = '4' in block.g
        home = {'28', '30'} & set(block.g)
        self._modal(block)
        self._check_others(block, dwells=dwells)
        if not dwells:
            self._move(block, home=bool(home))
        if any(code in STOPS for code in block.m):
            self._path.stop()
        return any(code in ENDS for code in block.m)

    def _check_names(self, block: _Block) -> None:
        for name in block.names:
            if name in HARMLESS_NAMES:
                continue
            why = 'is not known'
            if FRAMES.match(name):
                why = 'shifts, turns or scales the coordinates, or transforms them'
            elif CALLS.match(name):
                why = 'is a cycle, a call or a command'
            self._path.refuse(why, name)

    def _modal(self, block: _Block) -> None:
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
                self._path.refuse('scales positions or sets coordinates', 'G50')
            elif code in ('4', '28', '30', '53', '153') or code in HARMLESS_G:
                continue
            else:
                family = code.split('.')[0]
                why = 'is a cycle' if family in CYCLES else WHY.get(family, 'is not known')
                self._path.refuse(why, f'G{code}')

    def _check_others(self, block: _Block, *, dwells: bool) -> None:
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
                    self._path.refuse('moves an axis other than X, Y, Z', word)
                continue
            why = {
                'D': 'applies a tool offset', 'H': 'applies a tool length offset',
                'L': 'calls a subprogram',
            }.get(letter, 'is not supported')  # fmt: skip
            self._path.refuse(why, word)
        if block.radius is not None and self._motion not in '23' and not dwells:
            self._path.refuse('belongs to no arc', f'R{block.radius}')

    def _move(self, block: _Block, *, home: bool) -> None:
        machine = bool({'53', '153'} & set(block.g)) or 'SUPA' in block.names
        frame = MACHINE if machine else self._frame
        if home:
            gone: Position = dict.fromkeys(block.axes or 'XYZ')
            self._path.line_to(gone, frame)
            return
        arc = self._motion in '23'
        if not block.axes and not (arc and (block.centre or block.radius is not None)):
            return
        if machine and not self._absolute:
            self._path.refuse('combines machine coordinates with increments')
        goal: Position = {a: self._goal(a, *given) for a, given in block.axes.items()}
        if not arc:
            if block.centre:
                self._path.refuse('has a centre, but the motion is a line')
            before = dict(self._path.at)
            moved = [a for a, value in goal.items() if value != before[a]]
            self._path.slanted_rapids += self._motion == '0' and len(moved) > 1
            self._path.line_to(goal, frame)
            return
        centre = None
        if block.centre:
            centre = self._centre(block)
        elif block.radius is None:
            self._path.refuse('is an arc without centre (I, J, K) and radius (R)')
        radius = None if block.radius is None else block.radius * self._unit
        self._path.arc_to(goal, frame, self._plane, centre, radius, clockwise=self._motion == '2')

    def _goal(self, axis: str, value: Decimal, mode: str) -> Decimal | None:
        """Where an axis goes, m; None: from where it is not known by so much."""
        if mode == 'AC' or (self._absolute and not mode):
            return value * self._unit
        before = self._path.at[axis]
        return None if before is None else before + value * self._unit

    def _centre(self, block: _Block) -> dict[str, Decimal] | None:
        of_axis = dict(zip('XYZ', 'IJK', strict=True))
        letters = [of_axis[axis] for axis in self._plane]
        wrong = [letter for letter in block.centre if letter not in letters]
        if any(block.centre[letter][0] for letter in wrong):
            self._path.refuse(f'has {wrong[0]} in the plane {self._plane}')
        offsets = {}
        for axis, letter in zip(self._plane, letters, strict=True):
            value, mode = block.centre.get(letter, (Decimal(0), ''))
            start = self._path.at[axis]
            absolute = mode == 'AC' or (self._centre_absolute and not mode)
            if absolute and letter not in block.centre:
                self._path.refuse(f'has no {letter} for its centre (G90.1)')
            offsets[axis] = value * self._unit + (Decimal(0) if absolute else start or Decimal(0))
        return offsets


def _code(value: Decimal) -> str:
    """Number of a G or M word as it is spoken of: 1 for 01 and 1.0."""
    text = f'{value:f}'
    return (text.rstrip('0').rstrip('.') if '.' in text else text).lstrip('0+') or '0'


def without_comments(line: str) -> str | None:
    """Text of a block without comments in brackets and behind a semicolon; None: not closed."""
    parts: list[str] = []
    depth = at = 0
    while at < len(line):
        sign = line[at]
        if depth == 0 and sign == ';':
            break
        if depth == 0 and sign == '"':  # what SINUMERIK shows: MSG("...")
            at = line.find('"', at + 1)
            if at < 0:
                return None
            while parts and parts[-1] in ' (':
                parts.pop()
            at += len(line[at + 1 :]) - len(line[at + 1 :].lstrip(' )'))
            parts.append(' ')
        elif sign == '(' and (depth or not _calls(line[max(at - 30, 0) : at])):
            depth += 1
        elif sign == ')' and depth:
            depth -= 1
            parts.append(' ')
        elif not depth:
            parts.append(sign)
        at += 1
    return None if depth else ''.join(parts)


def _calls(before: str) -> bool:
    """Return whether a bracket belongs to the word before it, as in X=IC(10) or MSG("...")."""
    return bool(re.search(r'(?:^|[\s=])[A-Z_]{2,}\d*$', before))


# Reads the moves of a HEIDENHAIN Klartext program: L, and circles by CC and C or by CR.
#
# Whatever may move an axis otherwise or shifts what positions refer to is refused by its line and
# word. Source: HEIDENHAIN TNC 640 user's manual, Klartext programming: path functions L, CC, C,
# CR, M91, incremental I, cycles 9 (dwell) and 32 (tolerance), BLK FORM, TOOL CALL.

VALUE = r'[-+]?(?:\d+[.,]?\d*|[.,]\d+)'
COORDINATE = re.compile(rf'(?P<step>I?)(?P<axis>[A-Z])(?P<value>{VALUE})')
HARMLESS = re.compile(
    r'BLK FORM|TOOL (CALL|DEF)|CYCL DEF (9|32)(\.|$)|FUNCTION (MODE|PROG)|LBL 0\b|\*|F(MAX|\d)'
)
"""Commands that move no axis along the path."""
REFUSED = (
    (re.compile(r'CYCL DEF (7|8|10|11|19|26|247)\b'), 'shifts, turns or scales positions'),
    (re.compile(r'CYCL'), 'is a cycle'),
    (re.compile(r'(CALL )?LBL|CALL|SEL PGM'), 'is a subprogram or a call'),
    (re.compile(r'FN|Q[LRS]?\d|DECLARE|IF'), 'holds a variable or a decision'),
    (re.compile(r'LP|CP|CTP|LN|CT|RND|CHF|APPR|DEP|F[LC]T?\b|FPOL|FSELECT'), 'is a path function '
     'that is not read (read are L, C with CC, CR)'),
    (re.compile(r'TRANS|PLANE|FUNCTION|PRESET'), 'shifts or turns the coordinates'),
)  # fmt: skip
HARMLESS_M = re.compile(r'M(0?[0-9]|[1-8]\d|13|14|90|91|94|107|118|120|124|126|127|129|145|148)')
ACTIVE_PRESET = 'the active preset'


class Klartext:
    """State of a control that reads Klartext.

    Parameters
    ----------
    path : DrivenPath
        Filled with the moves.
    """

    def __init__(self, path: DrivenPath) -> None:
        self._path = path
        self._unit = MILLIMETRE
        self._centre: dict[str, Decimal] | None = None
        self._last: Position = {}

    def read(self, lines: Iterable[str]) -> None:
        """Read lines up to the end of the program."""
        waiting = ''
        for number, line in enumerate(lines, start=1):
            text = line.upper().partition(';')[0].strip()
            if waiting:
                text, waiting = f'{waiting} {text}', ''
            if text.endswith('~'):
                waiting = text[:-1].strip()
                continue
            text = re.sub(r'^/?\s*\d+\s+', '', text).strip()
            if not text or re.fullmatch(r'\d+', text):
                continue
            self._path.block = number, ' '.join(text.split())
            if re.match(r'/', line.strip()) and re.match(r'L|C', text):
                self._path.refuse('is skipped or executed depending on a switch')
            if self._run(' '.join(text.split())):
                return

    def _run(self, text: str) -> bool:
        """Run a block; True at the end of the program."""
        if text.startswith('BEGIN PGM'):
            self._unit = INCH if text.endswith('INCH') else MILLIMETRE
            return False
        if text.startswith('END PGM') or re.match(r'M(02|2|30)\b', text):
            return True
        if re.match(r'STOP\b|M0?[01]\b', text):
            self._path.stop()
            return False
        words = text.split()
        if words[0] in ('L', 'C', 'CC', 'CR'):
            return self._path_function(words)
        wrong = [w for w in words if w.startswith('M') and not HARMLESS_M.fullmatch(w)]
        if words[0].startswith('M') and not wrong:
            return False
        if not HARMLESS.match(text):
            why = next((why for form, why in REFUSED if form.match(text)), 'is not known')
            self._path.refuse(why)
        return False

    def _path_function(self, words: list[str]) -> bool:
        goal: Position = {}
        fields: dict[str, str] = {}
        for word in words[1:]:
            match = COORDINATE.fullmatch(word)
            if match and match['axis'] in 'XYZ':
                goal[match['axis']] = self._goal(word, match)
            elif match and match['axis'] in 'ABCUVW':
                if match['step'] or Decimal(match['value'].replace(',', '.')):
                    self._path.refuse('moves an axis other than X, Y, Z', word)
            elif re.fullmatch(r'R0|F(MAX|AUTO|[TZU]?\d[\d.,]*)', word):
                continue
            elif re.fullmatch(r'R[LR]', word):
                self._path.refuse('switches cutter compensation on', word)
            elif words[0] in ('C', 'CR') and re.fullmatch(rf'DR[-+]|R{VALUE}', word):
                fields[word[:2] if word.startswith('DR') else 'R'] = word
            elif word in ('M2', 'M02', 'M30') or HARMLESS_M.fullmatch(word):
                fields[word] = word
            else:
                self._path.refuse('is not supported', word)
        if words[0] == 'CC':
            self._take_centre(goal)
        elif goal or words[0] == 'C':
            self._move(words[0], goal, fields)
        if {'M0', 'M00', 'M1', 'M01'} & fields.keys():
            self._path.stop()
        return bool({'M2', 'M02', 'M30'} & fields.keys())

    def _goal(self, word: str, match: re.Match[str]) -> Decimal | None:
        """Where an axis goes, m; None: from where it is not known by so much."""
        if len(word) > LONGEST_NUMBER:
            self._path.refuse('has too many digits', word)
        value = Decimal(match['value'].replace(',', '.')) * self._unit
        if not match['step']:
            return value
        before = self._path.at[match['axis']]
        return None if before is None else before + value

    def _take_centre(self, goal: Position) -> None:
        """Centre of the next circles; without coordinates the last position."""
        x, y = (goal.get(axis, None if goal else self._path.at[axis]) for axis in 'XY')
        if 'Z' in goal or x is None or y is None:
            self._path.refuse('is not a centre in the plane of X and Y')
        self._centre = {'X': x, 'Y': y}

    def _move(self, kind: str, goal: Position, words: dict[str, str]) -> None:
        frame = MACHINE if {'M91'} & words.keys() else ACTIVE_PRESET
        if kind == 'L':
            self._path.line_to(goal, frame)
            return
        sense = words.get('DR')
        radius = words.get('R')
        if kind == 'C' and self._centre is None:
            self._path.refuse('is a circle without a centre (CC)')
        if sense is None or (kind == 'CR' and radius is None):
            self._path.refuse('has no sense (DR) or no radius (R)')
        self._path.arc_to(
            goal, frame, 'XY',
            self._centre if kind == 'C' else None,
            Decimal(radius[1:].replace(',', '.')) * self._unit if radius else None,
            clockwise=sense.endswith('-'),
        )  # fmt: skip


# An NC program as a path: the corner points of its moves, whatever the control.

EXAMINED_BYTES = 65536
"""Bytes by which a file is known to be a program."""
KLARTEXT = re.compile(r'^\s*\d*\s*(BEGIN PGM\b|L\s+I?[XYZ][-+]?\d)', re.MULTILINE | re.IGNORECASE)
BLOCK = re.compile(
    r'^\s*/?\s*(?:[N:]\s*\d+\s*)?(?:SUPA\s+)?(?:[GM]\s*\d+(\.\d+)?\s*)+(?=[A-Z;(*%]|$)'
)
MOTION = re.compile(r'(?<![A-Z])G\s*0*[0123](?![\d.])')
TABLE = re.compile(r'^\s*[-+.\d"]')


@dataclass(frozen=True)
class Program:
    """What a program drives.

    Attributes
    ----------
    points : ndarray, shape (n, 3), m
        Corner points in driving order; arcs as chords.
    form : str
        'G-code' or 'Klartext'.
    lines, arcs : int
        Moves of each kind.
    frames : tuple of str
        What positions refer to.
    said : str
        What it was read as.
    """

    points: Array
    form: str
    lines: int
    arcs: int
    frames: tuple[str, ...]
    said: str


def _text(name: str | Path, size: int = -1) -> str:
    try:
        with open(name, 'rb') as file:
            return file.read(size).decode('utf-8-sig', 'replace')
    except OSError as error:
        raise unreadable(name, error) from None


def is_klartext(text: str) -> bool:
    """Return whether a text is HEIDENHAIN Klartext."""
    return bool(KLARTEXT.search(text))


def is_program(name: str | Path) -> bool:
    """Return whether a file is an NC program, by its beginning; False if it cannot be read."""
    if not Path(name).is_file():
        return False
    text = _text(name, EXAMINED_BYTES)
    if '\0' in text:
        return False
    if is_klartext(text):
        return True
    blocks = 0
    for line in text.upper().splitlines():
        bare = (without_comments(line) or '').strip()
        blocks += bool(BLOCK.match(bare) and not TABLE.match(bare))
        if blocks and MOTION.search(bare):
            return True
    return False


def read_program(name: str | Path) -> Program:
    """Read the path that an NC program drives.

    Read are straight lines (G0, G1, L) and arcs (G2, G3, CC with C, CR) of X, Y and Z, absolute or
    in increments, in mm or inch. What else may move an axis is refused.

    Raises
    ------
    ConfigError
        If the file cannot be read; or names line and word that cannot be a path.
    """
    text = _text(name)
    path = DrivenPath(str(name))
    form = 'Klartext' if is_klartext(text) else 'G-code'
    reader = Klartext(path) if form == 'Klartext' else GCode(path)
    reader.read(text.splitlines())
    points = path.finish()
    return Program(
        points, form, path.lines, path.arcs, tuple(sorted(path.frames)), _words(form, path)
    )


def _words(form: str, path: DrivenPath) -> str:
    """State what a program was read as."""
    arcs = f' and {path.arcs} arcs, as chords of at most {1e3 * CHORD:g} mm' if path.arcs else ''
    lines = [f'NC program ({form}): {path.lines} straight moves{arcs}']
    offsets = [name for name in path.frames if name != MACHINE]
    if offsets:
        lines.append(
            f'positions in {offsets[0]} are treated as {MACHINE}: that offset has to be zero'
        )
    if path.slanted_rapids:
        lines.append(f'{path.slanted_rapids} rapid moves of several axes are treated as straight')
    return '; '.join([*lines, *path.remarks])

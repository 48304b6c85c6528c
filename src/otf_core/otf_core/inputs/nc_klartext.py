# SPDX-License-Identifier: Apache-2.0
"""Reads the moves of a HEIDENHAIN Klartext program: L, and circles by CC and C or by CR.

Whatever may move an axis otherwise or shifts what positions refer to is refused by its line and
word. Source: HEIDENHAIN TNC 640 user's manual, Klartext programming: path functions L, CC, C, CR,
M91, incremental I, cycles 9 (dwell) and 32 (tolerance), BLK FORM, TOOL CALL.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from decimal import Decimal

from otf_core.inputs.nc_gcode import INCH, LONGEST_NUMBER, MILLIMETRE
from otf_core.inputs.nc_path import MACHINE, DrivenPath, Position, refuse

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
        self._path, self._where = path, path.where
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
            if re.match(r'/', line.strip()) and re.match(r'L|C', text):
                refuse(self._where, number, line.strip(), 'is skipped or not by a switch')
            if self._run(number, ' '.join(text.split())):
                return

    def _run(self, number: int, text: str) -> bool:
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
            return self._path_function(number, text, words)
        wrong = [w for w in words if w.startswith('M') and not HARMLESS_M.fullmatch(w)]
        if words[0].startswith('M') and not wrong:
            return False
        if not HARMLESS.match(text):
            why = next((why for form, why in REFUSED if form.match(text)), 'is not known')
            refuse(self._where, number, text, why)
        return False

    def _path_function(self, number: int, text: str, words: list[str]) -> bool:
        goal: Position = {}
        found: dict[str, str] = {}
        for word in words[1:]:
            match = COORDINATE.fullmatch(word)
            if match and match['axis'] in 'XYZ':
                goal[match['axis']] = self._goal(number, word, match)
            elif match and match['axis'] in 'ABCUVW':
                if match['step'] or Decimal(match['value'].replace(',', '.')):
                    refuse(self._where, number, word, 'moves an axis that is none of X, Y, Z')
            elif re.fullmatch(r'R0|F(MAX|AUTO|[TZU]?\d[\d.,]*)', word):
                continue
            elif re.fullmatch(r'R[LR]', word):
                refuse(self._where, number, word, 'switches cutter compensation on')
            elif words[0] in ('C', 'CR') and re.fullmatch(rf'DR[-+]|R{VALUE}', word):
                found[word[:2] if word.startswith('DR') else 'R'] = word
            elif word in ('M2', 'M02', 'M30') or HARMLESS_M.fullmatch(word):
                found[word] = word
            else:
                refuse(self._where, number, word, 'is not known here')
        if words[0] == 'CC':
            self._take_centre(number, text, goal)
        elif goal or words[0] == 'C':
            self._move(number, text, words[0], goal, found)
        if {'M0', 'M00', 'M1', 'M01'} & found.keys():
            self._path.stop()
        return bool({'M2', 'M02', 'M30'} & found.keys())

    def _goal(self, number: int, word: str, match: re.Match[str]) -> Decimal | None:
        """Where an axis goes, m; None: from where it is not known by so much."""
        if len(word) > LONGEST_NUMBER:
            refuse(self._where, number, word, 'is a number of too many digits')
        value = Decimal(match['value'].replace(',', '.')) * self._unit
        if not match['step']:
            return value
        before = self._path.at[match['axis']]
        return None if before is None else before + value

    def _take_centre(self, number: int, text: str, goal: Position) -> None:
        """Centre of the next circles; without coordinates the last position."""
        x, y = (goal.get(axis, None if goal else self._path.at[axis]) for axis in 'XY')
        if 'Z' in goal or x is None or y is None:
            refuse(self._where, number, text, 'is no centre in the plane of X and Y')
        self._centre = {'X': x, 'Y': y}

    def _move(
        self, number: int, text: str, kind: str, goal: Position, found: dict[str, str]
    ) -> None:
        frame = MACHINE if {'M91'} & found.keys() else ACTIVE_PRESET
        if kind == 'L':
            self._path.line_to(number, text, goal, frame)
            return
        sense = found.get('DR')
        radius = found.get('R')
        if kind == 'C' and self._centre is None:
            refuse(self._where, number, text, 'is a circle without a centre (CC)')
        if sense is None or (kind == 'CR' and radius is None):
            refuse(self._where, number, text, 'lacks the sense (DR) or the radius (R)')
        self._path.arc_to(
            number, text, goal, frame, 'XY',
            self._centre if kind == 'C' else None,
            Decimal(radius[1:].replace(',', '.')) * self._unit if radius else None,
            clockwise=sense.endswith('-'),
        )  # fmt: skip

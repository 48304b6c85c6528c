# SPDX-License-Identifier: Apache-2.0
"""How a text table is written: its encoding, separator and quotes, and what a field may be.

The separator is the one with which most lines of the whole file (lines from its beginning, middle
and end) have the same number of columns, three of them or more with numbers. Quotes are those of
RFC 4180. Fields between white space may be a date and a time of day.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from otf_core.errors import InputError
from otf_core.files.text_moments import is_moment
from otf_core.files.writing import refuse_pipe, unreadable

SEPARATORS = ('\t', ';', '|', ',', None)
"""In the order in which they are tried; None: any white space."""
QUOTED_HEAD = 200
"""Lines in which fields of a head may take several."""
FEWEST = 3
"""Columns with numbers that a table has at least."""
COMMENT = re.compile(r'^\s*(#|//|!|%|"""|\*)+\s?')
_DIGITS = r"[\d.,'’\u00a0\u202f ]*\d"
NUMBER = re.compile(rf'[-+−]?{_DIGITS}(?:\.|{_DIGITS})?(?:[eE][-+]?\d+)?$')
"""A number in the form of any country, well formed or not."""
DATE = r'\d{1,4}[-./]\d{1,2}[-./]\d{1,4}'
TIME = r'\d{1,2}:\d\d:\d\d(?:[.,]\d+)?'
MISSING = re.compile(
    r'#?n/?a\.?|#n/d|#nv|#?div/0!?|#div/0!|#?value!|#wert!|#valeur!|#valor!|#ref!|#bezug!|#num!|'
    r'#zahl!|#name\??|#null!|null|none|nil|missing|-+|–+|—+|\*+|\?+|##+|\.{2,}|…',
    re.I,
)
"""What stands for a number that is not there."""
SPACED = re.compile(r'\d[ \t]+[-+.]?\d')
"""Two numbers in a field: commas between are those of decimals."""
FIELD = re.compile(rf'"(?:[^"]|"")*"|{DATE}[ \t]+{TIME}(?:[ \t]+(?:[AP]M|UTC))?|\S+')
"""A field between white space, where a date and a time are one."""
PLAIN_FIELD = re.compile(r'"(?:[^"]|"")*"|\S+')
DATED = re.compile(rf'(?:^|\s){DATE}[ \t]+{TIME}')


@dataclass(frozen=True)
class Dialect:
    """How lines are cut into fields.

    Attributes
    ----------
    separator : str or None
        None: white space.
    dated : bool
        Between white space, a date and the time of day after it are one field.
    width : int
        Fields of a line.
    """

    separator: str | None
    dated: bool = False
    width: int = 0

    def fields(self, line: str) -> list[str]:
        """Fields of a line, without white space around them; one, if its quotes are damaged."""
        if self.separator is None:
            if self.dated or '"' in line:
                found = (FIELD if self.dated else PLAIN_FIELD).findall(line)
                return [_unquoted(field) for field in found]
            return line.split()
        if '"' in line:
            try:
                row: list[str] = next(self._reader([line.strip(' ')]), [])
            except csv.Error:
                return [line.strip()]
            return [field.strip() for field in row]
        return [field.strip() for field in line.split(self.separator)]

    def columns(self, lines: Sequence[str]) -> list[list[str]] | None:
        """Fields of many lines by columns; None if not all have the same number of them.

        White space may be left around the fields.
        """
        text = '\n'.join(lines)
        if '"' not in text and not self.dated:
            if self.separator is None:
                if any(len(line.split()) != self.width for line in lines):
                    return None
                fields = text.split()
            else:
                gaps, separator = self.width - 1, self.separator
                if any(line.count(separator) != gaps for line in lines):
                    return None
                fields = text.replace(separator, '\n').split('\n')
            return [fields[k :: self.width] for k in range(self.width)]
        rows = self._quoted_rows(lines)
        if any(len(row) != self.width for row in rows):
            return None
        return [[row[k] for row in rows] for k in range(self.width)]

    def _quoted_rows(self, lines: Sequence[str]) -> list[list[str]]:
        if self.separator is not None:
            try:
                rows = list(self._reader([line.strip(' ') for line in lines]))
            except csv.Error:
                rows = []
            if len(rows) == len(lines):
                return rows
        return [self.fields(line) for line in lines]

    def _reader(self, lines: Sequence[str]) -> Iterator[list[str]]:
        return csv.reader(
            lines, delimiter=self.separator or ' ', skipinitialspace=True, strict=True
        )

    @property
    def words(self) -> str:
        """Name of the separator."""
        names = {'\t': 'tabs', ';': 'semicolons', ',': 'commas', '|': 'strokes'}
        return names.get(self.separator or '', 'white space')


def _unquoted(field: str) -> str:
    if field[:1] == '"' and field[-1:] == '"' and len(field) > 1:
        return field[1:-1].replace('""', '"').strip()
    return field


def is_number(text: str) -> bool:
    """Tell whether a field is a number in the form of any country, well formed or not."""
    return len(text) <= LONGEST and NUMBER.match(text) is not None


def is_value(text: str) -> bool:
    """Tell whether a field is a number, in any form, or a time of day."""
    if len(text) > LONGEST:
        return False
    return bool(NUMBER.match(text) or is_moment(text)) or text.lower() in ('nan', 'inf', '-inf')


LONGEST = 80
"""Letters of a field that may be a number."""


def is_missing(text: str) -> bool:
    """Tell whether a field says that there is no number."""
    return len(text) <= LONGEST and MISSING.fullmatch(text) is not None


def read_lines(path: str | Path) -> list[str]:
    """Lines of a text file, without their ends.

    A line break between quotes, as in a head of a spreadsheet, becomes a space; the lines that it
    takes stay as empty ones, so that numbers of lines stay right.

    Raises
    ------
    ConfigError
        If the file cannot be read or is a pipe.
    InputError
        If it is no text.
    """
    refuse_pipe(path)
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None
    if raw[:2] in (b'\xff\xfe', b'\xfe\xff'):
        text = raw.decode('utf-16', 'replace')
    elif b'\0' in raw[:4096]:
        raise InputError(f'{path}: is no text file; export the points as CSV or text')
    else:
        try:
            text = raw.decode('utf-8-sig')
        except UnicodeDecodeError:
            text = raw.decode('cp1252', 'replace')
    lines = text.replace('\r\n', '\n').replace('\r', '\n').split('\n')
    _join_quoted(lines)
    return lines


BROKEN = 5
"""Lines that a field of the head may take."""


def _join_quoted(lines: list[str]) -> None:
    """Join the lines of quoted fields of the head, in place."""
    for first in range(min(len(lines), QUOTED_HEAD)):
        if lines[first].count('"') % 2 == 0 or COMMENT.match(lines[first]):
            continue
        for last in range(first + 1, min(first + BROKEN, len(lines))):
            if lines[last].count('"') % 2:
                lines[first] = ' '.join(lines[first : last + 1])
                lines[first + 1 : last + 1] = [''] * (last - first)
                break


def find_dialect(lines: Sequence[str], head_widths: Sequence[int] = ()) -> Dialect | None:
    """Dialect in which most lines are rows of numbers; None if there are none.

    Parameters
    ----------
    lines : sequence of str
        Of the whole file, neither empty nor comments.
    head_widths : sequence of int
        For each of ``candidates()``, columns of the head, 0 where it names none; it decides
        between dialects, and numbers of columns, that suit as many lines.
    """
    best: tuple[tuple[int, bool], Dialect] | None = None
    for k, dialect in enumerate(candidates()):
        if dialect.dated and not any(map(DATED.search, lines)):
            continue
        named = head_widths[k] if head_widths else 0
        widths = Counter(w for line in lines if (w := _width(dialect, line)))
        if not widths:
            continue
        width, often = max(widths.items(), key=lambda item: (item[1], item[0] == named))
        rank = often, width == named
        if best is None or rank > best[0]:
            best = rank, Dialect(dialect.separator, dialect.dated, width)
    return None if best is None else best[1]


def candidates() -> list[Dialect]:
    """Dialects that are tried, in their order."""
    plain = [Dialect(separator) for separator in SEPARATORS]
    return [*plain[:-1], Dialect(None, dated=True), plain[-1]]


def _width(dialect: Dialect, line: str) -> int:
    """Columns of a line of data; 0 if it is none."""
    fields = dialect.fields(line)
    values = sum(map(is_value, fields))
    if values == 0 or values + sum(map(is_missing, fields)) < FEWEST:
        return 0
    if dialect.separator == ',' and any(SPACED.search(f) and not is_moment(f) for f in fields):
        return 0
    return len(fields)

# SPDX-License-Identifier: Apache-2.0
"""How a text table is written: encoding, separator, quotes, and its numbers."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import InputError
from otf_core.files.message_text import shortened
from otf_core.files.strict_yaml import value_text
from otf_core.files.text_moments import is_moment
from otf_core.files.writing import refuse_pipe, unreadable

# How a text table is written: its encoding, separator and quotes, and what a field may be.
#
# The separator is the one with which most lines of the whole file (lines from its beginning,
# middle and end) have the same number of columns, three of them or more with numbers. Quotes are
# those of RFC 4180. Fields between white space may be a date and a time of day.

SEPARATORS = ('\t', ';', '|', ',', None)
"""In the order in which they are tried; None: any white space."""
QUOTED_HEAD = 200
"""Lines in which fields of a head may take several."""
MIN_NUMBER_COLUMNS = 3
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
                texts = (FIELD if self.dated else PLAIN_FIELD).findall(line)
                return [_unquoted(field) for field in texts]
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
    """Return whether a field is a number in the form of any country, well formed or not."""
    return len(text) <= MAX_NUMBER_LETTERS and NUMBER.match(text) is not None


def is_value(text: str) -> bool:
    """Return whether a field is a number, in any form, or a time of day."""
    if len(text) > MAX_NUMBER_LETTERS:
        return False
    return bool(NUMBER.match(text) or is_moment(text)) or text.lower() in ('nan', 'inf', '-inf')


MAX_NUMBER_LETTERS = 80
"""Letters of a field that may be a number."""


def is_missing(text: str) -> bool:
    """Return whether a field says that there is no number."""
    return len(text) <= MAX_NUMBER_LETTERS and MISSING.fullmatch(text) is not None


def read_lines(path: str | Path) -> list[str]:
    """Lines of a text file, without their ends.

    A line break between quotes, as in a head of a spreadsheet, becomes a space; the lines that it
    takes stay as empty ones, so that numbers of lines stay right.

    Raises
    ------
    ConfigError
        If the file cannot be read or is a pipe.
    InputError
        If it is not a text.
    """
    refuse_pipe(path)
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None
    if raw[:2] in (b'\xff\xfe', b'\xfe\xff'):
        text = raw.decode('utf-16', 'replace')
    elif b'\0' in raw[:4096]:
        raise InputError(f'{path}: is not a text file; export the points as CSV or text')
    else:
        try:
            text = raw.decode('utf-8-sig')
        except UnicodeDecodeError:
            text = raw.decode('cp1252', 'replace')
    lines = text.replace('\r\n', '\n').replace('\r', '\n').split('\n')
    _join_quoted(lines)
    return lines


MAX_FIELD_LINES = 5
"""Lines that a field of the head may take."""


def _join_quoted(lines: list[str]) -> None:
    """Join the lines of quoted fields of the head, in place."""
    for first in range(min(len(lines), QUOTED_HEAD)):
        if lines[first].count('"') % 2 == 0 or COMMENT.match(lines[first]):
            continue
        for last in range(first + 1, min(first + MAX_FIELD_LINES, len(lines))):
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
    if values == 0 or values + sum(map(is_missing, fields)) < MIN_NUMBER_COLUMNS:
        return 0
    if dialect.separator == ',' and any(SPACED.search(f) and not is_moment(f) for f in fields):
        return 0
    return len(fields)


# Columns of text to numbers: decimal points or commas, thousands set off or not.
#
# How numbers are written is decided for a column as a whole, from all its fields, and by the other
# columns where these leave it open (1,234 alone may be 1.234 or 1234). A column in which fields
# contradict each other, or which stays open, is refused with a line. A field that holds no number
# at all is a fault of its line.

UNCLEAN = re.compile(r'[^0-9+\-.eE\n]')
"""Without these, what float() takes are numbers with a decimal point."""
GROUPS = " '’\u00a0\u202f"
"""Signs that set thousands off beside points and commas."""
_SIGN, _POWER = r'^[-+]?', r'(?:[eE][-+]?\d+)?$'
POINT_FOR_SURE = re.compile(
    rf'{_SIGN}(?:\d+\.(?!\d{{3}}$)\d*|(?:0\d*|\d{{4,}})?\.\d+|\d{{1,3}}(?:,\d{{3}})+\.\d*'
    rf'|\d{{1,3}}(?:,\d{{3}}){{2,}}|\d{{1,3}}(?:[{GROUPS}]\d{{3}})+\.\d*){_POWER}',
    re.MULTILINE,
)
COMMA_FOR_SURE = re.compile(
    rf'{_SIGN}(?:\d+,(?!\d{{3}}$)\d+|(?:0\d*|\d{{4,}})?,\d+|\d{{1,3}}(?:\.\d{{3}})+,\d+'
    rf'|\d{{1,3}}(?:\.\d{{3}}){{2,}}|\d{{1,3}}(?:[{GROUPS}]\d{{3}})+,\d+){_POWER}',
    re.MULTILINE,
)
_TWO_COMMAS, _TWO_POINTS = re.compile(r',\d+,'), re.compile(r'\.\d+\.')
OPEN = re.compile(r'^[-+]?[1-9]\d{0,2}([.,])\d{3}$', re.MULTILINE)
"""1,234 or 1.234."""
COMMAS = 'with decimal commas'
NOT_FINITE = ('nan', '+nan', '-nan', 'inf', '+inf', '-inf')


@dataclass(frozen=True)
class NumberColumn:
    """A column as decimal numbers.

    Attributes
    ----------
    texts : list of str
        With a decimal point, without thousands separators; 'nan' where there is no number.
    values : ndarray, shape (n,)
    faults : dict of int to str
        Of rows without a number: why.
    form : str
        How the numbers are written, in words; empty: with decimal points.
    """

    texts: list[str]
    values: Array
    faults: dict[int, str] = field(default_factory=dict)
    form: str = ''


@dataclass
class _Written:
    """A column as it stands in the file."""

    name: str
    texts: list[str]
    joined: str
    mark: str | None = None


def number_columns(
    where: str, lines: Sequence[int], columns: Sequence[tuple[str, list[str]]]
) -> list[NumberColumn]:
    """Read columns of numbers.

    Parameters
    ----------
    where : str
        File, for messages.
    lines : sequence of int
        Number of the line of every row.
    columns : sequence of (str, list of str)
        Name and fields of each.

    Raises
    ------
    InputError
        If how numbers are written contradicts itself or stays open; names column and line.
    """
    written = [_Written(shortened(name), texts, '\n'.join(texts)) for name, texts in columns]
    clean = [_clean(column.texts, column.joined) for column in written]
    if all(column is not None for column in clean):
        return [column for column in clean if column is not None]
    for column in written:
        column.texts = [text.strip().replace('−', '-') for text in column.texts]
        column.joined = '\n'.join(column.texts)
        column.mark = _sure_mark(where, lines, column)
    sure = {column.mark for column in written} - {None}
    for column in written:
        if column.mark is None:
            column.mark = _open_mark(where, lines, column, sure)
    return [_read(where, lines, column) for column in written]


def _clean(texts: list[str], joined: str) -> NumberColumn | None:
    """A column of plain numbers with decimal points, without going through its fields."""
    if UNCLEAN.search(joined):
        return None
    try:
        return NumberColumn(texts, np.array(list(map(float, texts)), dtype=np.float64))
    except ValueError:
        return None  # an empty field, two points


def _line_of(lines: Sequence[int], column: _Written, at: int) -> int:
    return lines[column.joined.count('\n', 0, at)]


def _sure_mark(where: str, lines: Sequence[int], column: _Written) -> str | None:
    """Decimal mark that fields leave no doubt about; InputError if they contradict each other."""
    joined = column.joined
    point = comma = None
    if '.' in joined or _TWO_COMMAS.search(joined):
        point = POINT_FOR_SURE.search(joined)
    if ',' in joined or _TWO_POINTS.search(joined):
        comma = COMMA_FOR_SURE.search(joined)
    if point and comma:
        raise InputError(
            f'{where}: {column.name}: line {_line_of(lines, column, point.start())} has '
            f'{value_text(point[0])}, with a decimal point, and line '
            f'{_line_of(lines, column, comma.start())} has {value_text(comma[0])}, with a decimal '
            f'comma; write the column in one form'
        )
    return '.' if point else ',' if comma else None


def _open_mark(where: str, lines: Sequence[int], column: _Written, sure: set[str | None]) -> str:
    """Decimal mark of a column whose fields leave it open, as 1,234 does."""
    match = OPEN.search(column.joined)
    if match is None:
        return '.'
    sign = match[1]
    fixed = all(OPEN.match(text) or not is_number(text) for text in column.texts)
    if sure == {sign} or (not sure and (fixed or sign == '.')):
        return sign
    if sure and sign not in sure and len(sure) == 1 and not fixed:
        return '.' if sign == ',' else ','  # some are set off, those below 1000 are not
    raise InputError(
        f'{where}: line {_line_of(lines, column, match.start())}: {column.name}: '
        f'{value_text(match[0])} may hold a thousands separator or decimals, and nothing in the '
        f'column settles it; write the numbers without thousands separators'
    )


def _read(where: str, lines: Sequence[int], column: _Written) -> NumberColumn:
    """Numbers of a column whose decimal mark is known."""
    mark = column.mark or '.'
    other = ',' if mark == '.' else '.'
    signs = [sign for sign in (other, *GROUPS) if sign in column.joined]
    if mark == ',' and not signs:
        joined = column.joined.replace(',', '.')
        fast = _clean(joined.split('\n'), joined)
        if fast is not None:
            return replace(fast, form=COMMAS if ',' in column.joined else '')
    numbers = ''.join(text for text in column.texts if is_number(text))
    groups = [sign for sign in signs if sign in numbers]
    if not groups:
        plain = rf'(?:\d+(?:{re.escape(mark)}\d*)?|{re.escape(mark)}\d+)'
        form = COMMAS if mark == ',' and ',' in numbers else ''
    else:
        group = re.escape(groups[0])
        plain = rf'\d{{1,3}}(?:{group}\d{{3}})*(?:{re.escape(mark)}\d*)?'
        called = 'space' if groups[0].isspace() else groups[0]
        decimal = 'comma' if mark == ',' else 'point'
        form = f'with thousands separated by {called} and decimal {decimal}s'
    accepted = re.compile(rf'[-+]?{plain}(?:[eE][-+]?\d+)?$')
    texts, faults = [], {}
    for row, text in enumerate(column.texts):
        if accepted.match(text):
            for sign in groups[:1]:
                text = text.replace(sign, '')
            texts.append(text.replace(',', '.') if mark == ',' else text)
        elif text.lower() in NOT_FINITE:
            texts.append(text)
        elif is_number(text):
            raise InputError(
                f'{where}: line {lines[row]}: {column.name}: {value_text(text)} is not written as '
                f'the other numbers of the column ({form or "with decimal points"}); thousands '
                f'separators and decimal marks have to be the same throughout'
            )
        else:
            texts.append('nan')
            faults[row] = _fault(column.name, text)
    values = np.array(list(map(float, texts)), dtype=np.float64)
    return NumberColumn(texts, values, faults, form)


def _fault(name: str, text: str) -> str:
    if not text:
        return f'{name} is empty'
    return f'{name} is {value_text(text)}' if is_missing(text) else f'{name} is not a number'

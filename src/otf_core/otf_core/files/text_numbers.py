# SPDX-License-Identifier: Apache-2.0
"""Columns of text to numbers: decimal points or commas, thousands set off or not.

How numbers are written is decided for a column as a whole, from all its fields, and by the other
columns where these leave it open (1,234 alone may be 1.234 or 1234). A column in which fields
contradict each other, or which stays open, is refused with a line. A field that holds no number
at all is a fault of its line.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import InputError
from otf_core.files.strict_yaml import shown
from otf_core.files.text_dialect import is_missing, is_number

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
    written = [_Written(shown_name(name), texts, '\n'.join(texts)) for name, texts in columns]
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


def shown_name(name: str) -> str:
    """Name of a column, for messages."""
    return name if len(name) <= LONGEST_NAME else f'{name[:LONGEST_NAME]} ...'


LONGEST_NAME = 60
"""Letters."""


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
            f'{shown(point[0])}, with a decimal point, and line '
            f'{_line_of(lines, column, comma.start())} has {shown(comma[0])}, with a decimal '
            f'comma; write the column in one form'
        )
    return '.' if point else ',' if comma else None


def _open_mark(where: str, lines: Sequence[int], column: _Written, sure: set[str | None]) -> str:
    """Decimal mark of a column whose fields leave it open, as 1,234 does."""
    found = OPEN.search(column.joined)
    if found is None:
        return '.'
    sign = found[1]
    fixed = all(OPEN.match(text) or not is_number(text) for text in column.texts)
    if sure == {sign} or (not sure and (fixed or sign == '.')):
        return sign
    if sure and sign not in sure and len(sure) == 1 and not fixed:
        return '.' if sign == ',' else ','  # some are set off, those below 1000 are not
    raise InputError(
        f'{where}: line {_line_of(lines, column, found.start())}: {column.name}: '
        f'{shown(found[0])} may hold a thousands separator or decimals, and nothing in the '
        f'column decides; write the numbers without thousands separators'
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
        form = f'with thousands set off by {called} and decimal {decimal}s'
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
                f'{where}: line {lines[row]}: {column.name}: {shown(text)} is not written as the '
                f'other numbers of the column ({form or "with decimal points"}); thousands '
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
    return f'{name} is {shown(text)}' if is_missing(text) else f'{name} is no number'

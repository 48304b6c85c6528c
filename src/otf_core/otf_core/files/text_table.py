# SPDX-License-Identifier: Apache-2.0
"""A table in a text file: one grammar for samples, points, paths, lattices and readings.

A file is lines before the data, then data. Before the data stand comments, and a head: a line of
names of the columns, whose number has to be that of the columns; a line below it may state units.
Whatever else stands below the head is data, with a fault if need be. No line is passed over
without being counted: ``TextTable.faults`` holds why, and where. docs/commands.md has the grammar
as a table. What can be read in two ways is refused.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import InputError
from otf_core.files.message_text import shortened
from otf_core.files.strict_yaml import value_text
from otf_core.files.text_times import LONG_TIMES, TIMES
from otf_core.files.writing import refuse_pipe, unreadable

# Units that headings state, and the factors that take them to m, rad and s.

LENGTHS = {
    'm': 1.0, 'dm': 1e-1, 'cm': 1e-2, 'mm': 1e-3, 'um': 1e-6, 'µm': 1e-6, 'μm': 1e-6,
    'in': 0.0254, 'inch': 0.0254, 'inches': 0.0254, 'zoll': 0.0254, 'metre': 1.0, 'metres': 1.0,
    'meter': 1.0, 'meters': 1.0, 'millimetre': 1e-3, 'millimetres': 1e-3, 'millimeter': 1e-3,
    'millimeters': 1e-3, 'micron': 1e-6, 'microns': 1e-6,
}  # fmt: skip
"""To m."""
ANGLES = {
    'rad': 1.0, 'mrad': 1e-3, 'urad': 1e-6, 'µrad': 1e-6, 'μrad': 1e-6, 'deg': math.pi / 180,
    'degree': math.pi / 180, 'degrees': math.pi / 180, '°': math.pi / 180, 'gon': math.pi / 200,
    'arcsec': math.pi / 648000, '"': math.pi / 648000,
}  # fmt: skip
"""To rad."""
OTHERS = ('mil', 'mils', 'ft', 'foot', 'feet', 'nm', 'km', 'grad', 'grads')
"""Units that a heading may state and nothing is read in: refused, never taken for another. A grad
is a degree in German and a gon in English."""
BRACKETED = re.compile(r'^(?P<name>.*?)\s*[\[({<]\s*(?P<unit>[^\])}>]*?)\s*[\])}>]\s*$')
SUFFIX = re.compile(
    r'^(?P<name>.+?)(?:\s+in)?[_ /]+'
    r'(?P<unit>m|dm|cm|mm|um|µm|μm|inch|in|mil|ft|nm|km|s|sec|ms|us|µs|ns|min|h|days|deg|grad|gon|'
    r'rad|mrad|urad|µrad|μrad|arcsec)$',
    re.IGNORECASE,
)
MAX_HEADING_LETTERS = 200
"""Letters of a heading."""


def is_unit(text: str) -> bool:
    """Return whether a text is the name of a unit."""
    return any(text.lower() in known for known in (LENGTHS, ANGLES, TIMES, LONG_TIMES, OTHERS))


def split_heading(heading: str) -> tuple[str, str | None]:
    """Name, in its own case, and unit of a heading; brackets without a unit stay in the name."""
    text = ' '.join(heading[:MAX_HEADING_LETTERS].strip().lstrip('%').split())
    match = BRACKETED.match(text)
    if match is not None and not match['name']:
        return match['unit'], None  # '[Timestamp]'
    if match is None or not is_unit(match['unit']):
        match = SUFFIX.match(text)
    return (text, None) if match is None else (match['name'], match['unit'].lower())


def known_lengths() -> str:
    """Return units of length, as messages name them."""
    return 'm, dm, cm, mm, µm (or um), inch'


def unit_hint(stated: float, expected: float) -> str:
    """Unit that lengths may be in, whose size, read in m, is another than expected.

    Parameters
    ----------
    stated, expected : float
        m; the largest coordinates.

    Returns
    -------
    str
        'mm', 'um', 'inch', 'cm' or empty.
    """
    if expected <= 0.0 or stated <= 0.0:
        return ''
    fits = [u for u in HINTED if 0.5 < stated * LENGTHS[u] / expected < 1.05]
    return fits[0] if fits else ''


HINTED = ('mm', 'inch', 'um', 'cm')
"""In the order of how usual they are."""


def unit_words(unit: str) -> str:
    """Unit as people read it."""
    return 'µm' if unit == 'um' else unit


# Fields and numbers.

SEPARATORS = ('\t', ';', '|', ',', None)
"""In the order in which they are tried; None: any white space."""
MIN_NUMBER_COLUMNS = 3
"""Columns with numbers that a table has at least."""
COMMENT = re.compile(r'^\s*(#|//|%|!)+\s?')
NO_COMMENT = re.compile(r'\s*"?#(?:(?:N/A|N/D|NV|[A-Z/0]+[!?])"?(?:[\s;,|]|$)|#*"?[;,|\t])')
"""What spreadsheets have in place of a number."""
PLAIN = re.compile(r'[0-9+\-.eE\n]*')
NUMBER = re.compile(r'[-+−]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?$')
"""With a decimal point or a decimal comma."""
GROUPED = re.compile(r"[-+−]?\d{1,3}(?:[.,'’ \u00a0\u202f]\d+)+(?:[.,]\d*)?$")
"""With thousands set off."""
OPEN = re.compile(r'[-+−]?[1-9]\d{0,2},\d{3}$')
"""1,234 may be 1234 or 1.234."""
SPACED = re.compile(r'\d[ \t]+[-+.]?\d')
"""Two numbers in a field: commas between are those of decimals."""
NOT_FINITE = ('nan', '+nan', '-nan', 'inf', '+inf', '-inf')
MAX_NUMBER_LETTERS = 80
"""Letters of a field that may be a number."""


def is_value(text: str) -> bool:
    """Return whether a field is a number."""
    if len(text) > MAX_NUMBER_LETTERS:
        return False
    return bool(NUMBER.match(text) or GROUPED.match(text)) or text.lower() in NOT_FINITE


def fields_of(line: str, separator: str | None) -> list[str]:
    """Fields of a line, without white space around them; one, if its quotes are damaged."""
    if '"' not in line:
        return [f.strip() for f in line.split(separator)]
    text = line.strip(' ') if separator else ' '.join(line.split())
    try:
        rows = list(
            csv.reader([text], delimiter=separator or ' ', skipinitialspace=True, strict=True)
        )
    except csv.Error:
        return [line.strip()]
    return [field.strip() for row in rows for field in row]


@dataclass(frozen=True)
class NumberColumn:
    """A column as decimal numbers.

    Attributes
    ----------
    texts : list of str
        With a decimal point; 'nan' where there is no number.
    values : ndarray, shape (n,)
    faults : dict of int to str
        Of rows without a number: why.
    """

    texts: list[str]
    values: Array
    faults: dict[int, str] = field(default_factory=dict)


def number_columns(
    where: str, lines: Sequence[int], columns: Sequence[tuple[str, Sequence[str]]]
) -> tuple[list[NumberColumn], bool]:
    """Read columns of numbers; whether they have decimal commas.

    Parameters
    ----------
    where : str
        File, for messages.
    lines : sequence of int
        Number of the line of every row.
    columns : sequence of (str, sequence of str)
        Name and fields of each.

    Raises
    ------
    InputError
        If thousands are set off, or points and commas are mixed; names column and line.
    """
    plain = [_plain_column(texts) for _, texts in columns]
    if all(plain):
        return [column for column in plain if column is not None], False
    marks: dict[str, str] = {}
    whole = sure = ''
    for name, texts in columns:
        for row, text in enumerate(texts):
            place = f'{where}: line {lines[row]}: {shortened(name)}: {value_text(text)}'
            if not NUMBER.match(text):
                if GROUPED.match(text):
                    raise InputError(
                        f'{place} is not a plain number; write the numbers without thousands '
                        f'separators, and with the same decimal mark throughout'
                    )
                continue
            mark = ',' if ',' in text else '.' if '.' in text else ''
            if mark and not (marks.setdefault(mark, place) and len(marks) < 2):
                other = marks['.' if mark == ',' else ',']
                raise InputError(
                    f'{place} and {other.removeprefix(where + ": ")}: decimal points and decimal '
                    f'commas are mixed; write the table in one form'
                )
            whole = whole or ('' if mark else place)
            sure = sure or (place if mark == ',' and not OPEN.match(text) else '')
    if ',' in marks and whole and not sure:
        raise InputError(
            f'{marks[","]} may hold a thousands separator or decimals, and nothing in the table '
            f'settles it; write the numbers without thousands separators'
        )
    return [_column(shortened(name), texts) for name, texts in columns], ',' in marks


def _plain_column(texts: Sequence[str]) -> NumberColumn | None:
    """A column of numbers with decimal points, without going through its fields."""
    if PLAIN.fullmatch('\n'.join(texts)) is None:
        return None
    try:
        return NumberColumn(list(texts), np.array(list(map(float, texts)), dtype=np.float64))
    except ValueError:
        return None  # an empty field, two points


def _column(name: str, texts: Sequence[str]) -> NumberColumn:
    read, faults = [], {}
    for row, text in enumerate(texts):
        if NUMBER.match(text) or text.lower() in NOT_FINITE:
            read.append(text.replace(',', '.').replace('−', '-'))
            continue
        faults[row] = f'{name} is {value_text(text)}' if text else f'{name} is empty'
        read.append('nan')
    return NumberColumn(read, np.array(list(map(float, read)), dtype=np.float64), faults)


def read_lines(path: str | Path) -> list[str]:
    """Lines of a text file, without their ends.

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
    return text.replace('\r\n', '\n').replace('\r', '\n').split('\n')


# The table.

IsHead = Callable[[Sequence[str]], bool]
"""Tells whether fields are the names of the columns that are looked for."""

STATEMENT = re.compile(r'^[\w ]+=')
"""'AXES = CARTESIAN: X, Y, Z (mm)' names no columns."""
RULE = re.compile(r'[-=_+|: \t]{3,}$')
WIDE = re.compile(r'[ \t]{2,}')
"""Between names of several words, where columns stand apart by white space."""
UNIT_APART = re.compile(r'(?<=\S)[ \t]+[\[(]([^\s\])]*)[\])](?=\s|$)')
"""A unit in brackets after a name: 'X [mm] Y [mm]'."""
EXAMINED_LINES = 300
"""Lines of the beginning, the middle and the end, by which the separator is found."""
REASONS_SHOWN = 6
"""Reasons in a message."""


@dataclass(frozen=True)
class TextTable:
    """A table as text.

    Attributes
    ----------
    where : str
        File name, for messages.
    columns : list of sequence of str
        Fields of the lines of data.
    lines : sequence of int
        Number of each line of data in the file, from 1.
    head : list of str
        Lines before them, without signs of comments.
    names : tuple of str, optional
        Of the columns; None: no head that is looked for.
    units : tuple of str
        Of the columns, as a line below the head states them; empty: there is none.
    separator : str or None
        Between fields; None: white space.
    head_line : int
        Number of the line of names; 0: there is none.
    comments : mapping of int to str
        Numbers of the lines of comments, and their texts without the sign.
    faults : mapping of int to str
        Numbers of the lines that are no rows, and why.
    """

    where: str
    columns: list[tuple[str, ...]]
    lines: Sequence[int]
    head: list[str]
    names: tuple[str, ...] | None
    units: tuple[str, ...]
    separator: str | None
    head_line: int = 0
    comments: Mapping[int, str] = field(default_factory=dict)
    faults: Mapping[int, str] = field(default_factory=dict)

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.columns)

    def row(self, at: int) -> list[str]:
        """Fields of a line of data."""
        return [column[at] for column in self.columns]

    def numbers(self, columns: Mapping[int, str]) -> tuple[list[NumberColumn], bool]:
        """Columns of numbers by place and name, see ``number_columns``."""
        named = [(name, self.columns[place]) for place, name in columns.items()]
        return number_columns(self.where, self.lines, named)


@dataclass(frozen=True)
class SkippedLines:
    """Lines that are left out for one reason: why, how many, and the number of the first."""

    reason: str
    lines: int
    first_line: int


def reason_counts(faults: Mapping[int, str]) -> list[SkippedLines]:
    """Reasons for which lines are left out."""
    counts: dict[str, tuple[int, int]] = {}
    for line, reason in sorted(faults.items()):
        often, first = counts.get(reason, (0, line))
        counts[reason] = often + 1, first
    return [SkippedLines(reason, often, first) for reason, (often, first) in counts.items()]


def fault_words(faults: Mapping[int, str]) -> str:
    """The same in words."""
    parts = [
        f'{group.lines} lines: {group.reason} (first line {group.first_line})'
        if group.lines > 1
        else f'1 line: {group.reason} (line {group.first_line})'
        for group in reason_counts(faults)
    ]
    more = [f'{len(parts) - REASONS_SHOWN} more kinds'] if len(parts) > REASONS_SHOWN else []
    return '; '.join([*parts[:REASONS_SHOWN], *more])


def read_text_table(path: str | Path, is_head: IsHead | None = None) -> TextTable:
    """Read a table.

    Parameters
    ----------
    is_head : callable, optional
        Tells of the fields of a line whether they name the columns that are looked for; without
        it what the columns are is said elsewhere.

    Raises
    ------
    ConfigError
        If the file cannot be read.
    InputError
        If it holds no table of numbers, or head and lines have other numbers of columns; says
        what was seen, and where.
    """
    where, every = str(path), read_lines(path)
    found = _separator(every)
    if found is None:
        for number, line in enumerate(every, start=1):
            if is_head is not None and any(is_head(_names(line, s)) for s in SEPARATORS):
                raise InputError(
                    f'{where}: holds no points: no line of numbers below line {number}'
                )
        first = next((shortened(line.strip(), 60) for line in every if line.strip()), '')
        raise InputError(
            f'{where}: holds no lines of at least {MIN_NUMBER_COLUMNS} numbers; the first line '
            f'is {first!r}; export time, x, y, z of every sample, one sample per line'
        )
    separator, width, first_row = found
    at, names = _head(every[:first_row], separator, width, is_head)
    faults: dict[int, str] = {}
    comments: dict[int, str] = {}
    signs: set[str] = set()
    units: tuple[str, ...] = ()
    for k, line in enumerate(every[:first_row]):
        text = COMMENT.sub('', line) if is_comment(line) else line
        if text != line:
            signs.add(line.strip()[0])
            comments[k + 1] = text.strip()
        fields = fields_of(text, separator)
        stripped = [f.strip('[](){} ') for f in fields]
        if k > at and sum(map(is_unit, stripped)) >= MIN_NUMBER_COLUMNS:
            units = tuple(stripped)
        elif k > at and text == line and _is_datum(fields, width, headed=at >= 0):
            faults[k + 1] = _misfit(fields, width)
    body = every[first_row:]
    while body and not any(fields_of(body[-1], separator)):
        body.pop()  # empty lines, or lines of separators, after the data
    rows, lines = [], []
    for number, line in enumerate(body, start=first_row + 1):
        fields = fields_of(line, separator)
        if is_comment(line) and (line.strip()[0] in signs or len(fields) != width):
            comments[number] = COMMENT.sub('', line).strip()
        elif len(fields) == width:
            rows.append(fields)
            lines.append(number)
        elif any(fields):
            faults[number] = _misfit(fields, width)
    columns = list(zip(*rows, strict=True))
    if names is not None and len(names) == width - 1 and not any(columns[-1]):
        columns.pop()  # a separator at the end of every line
    elif names is not None and len(names) != width:
        raise InputError(
            f'{where}: the header (line {at + 1}) names {len(names)} columns, the lines have '
            f'{width}: {shortened(every[at].strip(), 80)!r}; correct the header, or omit it and '
            f'name the columns with --columns (a - leaves one out)'
        )
    head = [COMMENT.sub('', line).strip() for line in every[:first_row]]
    return TextTable(
        where, columns, lines, [h for h in head if h], names, units, separator, at + 1, comments,
        faults,
    )  # fmt: skip


def is_comment(line: str) -> bool:
    """Return whether a line is a comment by its sign, and no datum such as #N/A."""
    return COMMENT.match(line) is not None and NO_COMMENT.match(line) is None


def _separator(lines: Sequence[str]) -> tuple[str | None, int, int] | None:
    """Separator with which most lines have one number of columns, and the first of these lines."""
    sample = lines
    if len(lines) > 3 * EXAMINED_LINES:
        middle = len(lines) // 2
        sample = [*lines[:EXAMINED_LINES], *lines[middle : middle + EXAMINED_LINES],
                  *lines[-EXAMINED_LINES:]]  # fmt: skip
    best: tuple[int, str | None, int] = 0, None, 0
    for separator in SEPARATORS:
        widths = Counter(w for line in sample if (w := _width(line, separator)))
        width, often = max(widths.items(), key=lambda item: item[1], default=(0, 0))
        if often > best[0]:
            best = often, separator, width
    often, separator, width = best
    if not often:
        return None
    first = next(k for k, line in enumerate(lines) if _width(line, separator) == width)
    return separator, width, first


def _width(line: str, separator: str | None) -> int:
    """Columns of a line of data; 0 if it is none."""
    if not line.strip() or is_comment(line):
        return 0
    fields = fields_of(line, separator)
    if separator == ',' and any(':' not in f and SPACED.search(f) for f in fields):
        return 0
    return len(fields) if sum(map(is_value, fields)) >= MIN_NUMBER_COLUMNS else 0


def _names(line: str, separator: str | None) -> list[str]:
    """Fields of a line of names; empty if it is none."""
    if separator is None:
        line = UNIT_APART.sub(lambda m: m[0].lstrip() if is_unit(m[1]) else m[0], line)
    fields = fields_of(line, separator)
    is_none = STATEMENT.match(line) or len(fields) < MIN_NUMBER_COLUMNS
    return [] if is_none or any(map(is_value, fields)) else fields


def _head(
    lines: Sequence[str], separator: str | None, width: int, is_head: IsHead | None
) -> tuple[int, tuple[str, ...] | None]:
    """Index of the line of names before the data, -1 if there is none, and the names."""
    misfit: tuple[int, tuple[str, ...]] | None = None
    for k in reversed(range(len(lines) if is_head else 0)):
        comment = is_comment(lines[k])
        text = COMMENT.sub('', lines[k]) if comment else lines[k]
        tried = [_names(text, s) for s in ((separator, *SEPARATORS) if comment else (separator,))]
        if separator is None:
            tried.append(WIDE.split(text.strip()))
        for names in tried:
            while len(names) > width and not names[-1]:
                names.pop()
            if not names or is_head is None or not is_head(names):
                continue
            if len(names) == width:
                return k, tuple(names)
            if misfit is None and not (comment and any(' ' in name for name in names)):
                misfit = k, tuple(names)  # and no sentence
    return misfit or (-1, None)


def _is_datum(fields: Sequence[str], width: int, *, headed: bool) -> bool:
    """Return whether a line before the first row is one of data with a fault."""
    if len(fields) < width and RULE.match(''.join(fields)):
        return False
    if headed:
        return any(fields)
    values = [is_value(f) for f in fields]
    return len(fields) > 1 and (all(values) or (any(values) and len(fields) == width))


def _misfit(fields: Sequence[str], width: int) -> str:
    """Why a line is no row."""
    if len(fields) == width:
        missing = next((f for f in fields if f and not is_value(f)), '')
        return f'{value_text(missing)} in place of a number' if missing else 'an empty field'
    if len(fields) == 1:
        return f'no line of {width} columns'
    return f'{len(fields)} columns instead of {width}'

# SPDX-License-Identifier: Apache-2.0
"""A table in a text file: one grammar for samples, points, paths, lattices and readings."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from otf_core.errors import InputError
from otf_core.files.message_text import shortened
from otf_core.files.strict_yaml import value_text
from otf_core.files.text_dialect import (
    COMMENT,
    MIN_NUMBER_COLUMNS,
    Dialect,
    NumberColumn,
    candidates,
    find_dialect,
    is_missing,
    is_value,
    number_columns,
    read_lines,
)

# Units that headings state, and the factors that take them to m, rad and s.

LENGTHS = {
    'm': 1.0, 'dm': 1e-1, 'cm': 1e-2, 'mm': 1e-3, 'um': 1e-6, 'µm': 1e-6, 'μm': 1e-6,
    'in': 0.0254, 'inch': 0.0254, 'inches': 0.0254, 'zoll': 0.0254, 'pouce': 0.0254,
    'pouces': 0.0254, 'metre': 1.0, 'metres': 1.0, 'meter': 1.0, 'meters': 1.0,
    'millimetre': 1e-3, 'millimetres': 1e-3, 'millimeter': 1e-3, 'millimeters': 1e-3,
    'micron': 1e-6, 'microns': 1e-6, '毫米': 1e-3, '米': 1.0, '微米': 1e-6, '英寸': 0.0254,
}  # fmt: skip
"""To m."""
ANGLES = {
    'rad': 1.0, 'mrad': 1e-3, 'urad': 1e-6, 'µrad': 1e-6, 'μrad': 1e-6,
    'deg': math.pi / 180, 'degree': math.pi / 180, 'degrees': math.pi / 180,
    '°': math.pi / 180, '度': math.pi / 180,
    'gon': math.pi / 200, 'arcsec': math.pi / 648000, '"': math.pi / 648000,
}  # fmt: skip
"""To rad."""
AMBIGUOUS = ('grad', 'grads')
"""Degrees in German and Italian, gon in English and on instruments: has to be stated."""
TIMES = {
    's': 0, 'sec': 0, 'secs': 0, 'second': 0, 'seconds': 0, 'sekunden': 0, '秒': 0,
    'ms': -3, 'msec': -3, 'milliseconds': -3, '毫秒': -3,
    'us': -6, 'usec': -6, 'µs': -6, 'μs': -6, 'ns': -9, 'nsec': -9, 'nsecs': -9, 'nanosec': -9,
}  # fmt: skip
"""Powers of ten, to s."""
LONG_TIMES = {
    'min': 60, 'minute': 60, 'minutes': 60, 'minuten': 60, 'h': 3600, 'hour': 3600, 'hours': 3600,
    'std': 3600, 'day': 86400, 'days': 86400, 'tage': 86400,
}  # fmt: skip
"""To s."""
OTHERS = (
    'mil', 'mils', 'ft', 'foot', 'feet', 'nm', 'km', *AMBIGUOUS,
)  # fmt: skip
"""Units that a heading may state and nothing is read in: refused, never taken for another."""
BRACKETED = re.compile(
    r'^(?P<name>.*?)\s*[\[({<（【]\s*(?P<unit>[^\])}>）】]*)\s*[\])}>）】]\s*$', re.DOTALL
)
SUFFIX = re.compile(
    r'^(?P<name>.+?)[_ /]'
    r'(?P<unit>m|dm|cm|mm|um|µm|μm|inch|in|mil|ft|nm|km|s|sec|ms|us|µs|ns|min|deg|grad|gon|'
    r'rad|mrad|urad|dmy|mdy|ymd)$'
)

MAX_HEADING_LETTERS = 200
"""Letters of a heading."""
LINK = re.compile(r'(?:\s+in|[\s/,:-]+)$')
"""Between a name and its unit: 'X in mm', 'X / mm'."""


def is_unit(text: str) -> bool:
    """Return whether a text is the name of a unit."""
    text = text.lower()
    return any(text in known for known in (LENGTHS, ANGLES, TIMES, LONG_TIMES, OTHERS))


def split_heading(heading: str) -> tuple[str, str | None]:
    """Name, in lower case, and unit of a heading; brackets without a unit stay in the name."""
    if len(heading) > MAX_HEADING_LETTERS:
        return heading[:MAX_HEADING_LETTERS].lower(), None
    text = ' '.join(heading.strip().lstrip('%').split())
    match = BRACKETED.match(text)
    if match is not None and not match['name'].strip():
        return match['unit'].strip().lower(), None  # '[Timestamp]'
    if match is not None and is_unit(match['unit'].strip()):
        return match['name'].strip().lower(), match['unit'].strip().lower()
    match = SUFFIX.match(text.lower())
    if match is not None:
        return LINK.sub('', match['name']).strip(), match['unit']
    return text.lower(), None


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


# A table in a text file: one grammar for samples, points, paths, lattices and readings.
#
# A file is lines before the data, then data. Before the data stand comments, and a head: a line of
# names of the columns, whose number has to be that of the columns; lines above it may name groups
# of columns, a line below it units. Whatever else stands below the head is data, with a fault if
# need be. In the data a comment begins with the sign with which comments began before. No line is
# passed over without being counted: ``TextTable.faults`` holds why, and where. docs/commands.md
# has the grammar as a table.

IsHead = Callable[[Sequence[str]], bool]
"""Tells whether fields are the names of the columns that are looked for."""

STATEMENT = re.compile(r'^[\w ]+=')
"""'AXES = CARTESIAN: X, Y, Z (mm)' names no columns."""
RULE = re.compile(r'[-=_+|: \t]{3,}$')
SIGNED = re.compile(r'^\s*(?:#|//|%|!)', re.MULTILINE)
SIGNS = ('#', '//', '%', '!')
"""With which comments may begin between the data."""


@dataclass(frozen=True)
class TextTable:
    """A table as text.

    Attributes
    ----------
    where : str
        File name, for messages.
    columns : list of list of str
        Fields of the lines of data; white space may be left around them.
    lines : sequence of int
        Number of each line of data in the file, from 1.
    head : list of str
        Lines before them, without signs of comments.
    names : tuple of str, optional
        Of the columns, with the names of their groups in front; None: no head that is looked for.
    units : tuple of str
        Of the columns, as a line below the head states them; empty: there is none.
    head_line : int
        Number of the line of names; 0: there is none.
    comments : mapping of int to str
        Numbers of the lines of comments, and their texts without the sign.
    faults : mapping of int to str
        Numbers of the lines that are no rows, and why.
    """

    where: str
    columns: list[list[str]]
    lines: Sequence[int]
    head: list[str]
    names: tuple[str, ...] | None
    units: tuple[str, ...]
    dialect: Dialect
    head_line: int = 0
    comments: Mapping[int, str] = field(default_factory=dict)
    faults: Mapping[int, str] = field(default_factory=dict)

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.dialect.width

    def column(self, place: int) -> list[str]:
        """Fields of a column."""
        return [text.strip() for text in self.columns[place]]

    def row(self, at: int) -> list[str]:
        """Fields of a line of data."""
        return [column[at].strip() for column in self.columns]

    def numbers(self, columns: Mapping[int, str]) -> list[NumberColumn]:
        """Columns of numbers; places and names, for messages.

        Raises
        ------
        InputError
            See ``text_numbers.number_columns``.
        """
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
    shown = (
        parts
        if len(parts) <= REASONS_SHOWN
        else [*parts[:REASONS_SHOWN], f'{len(parts) - REASONS_SHOWN} more kinds']
    )
    return '; '.join(shown)


REASONS_SHOWN = 6
"""Reasons in a message."""


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
    _open_ply(where, every)
    plain = _plain(every[:EXAMINED_LINES])
    widths = [_head_width(plain, dialect, is_head) for dialect in candidates()] if is_head else ()
    dialect = find_dialect(_sample(every), widths)
    if dialect is None:
        head = next((n for n, line in enumerate(every) if _is_named(line, is_head)), None)
        if head is not None:
            raise InputError(f'{where}: holds no points: no line of numbers below line {head + 1}')
        first = next((shortened(line.strip(), 60) for line in every if line.strip()), '')
        raise InputError(
            f'{where}: holds no lines of at least {MIN_NUMBER_COLUMNS} numbers; the first line '
            f'is {first!r}; export time, x, y, z of every sample, one sample per line'
        )
    return _Reader(where, every, dialect, is_head).table()


def _plain(lines: Sequence[str]) -> list[str]:
    """Lines that are neither empty nor comments."""
    return [line for line in lines if line.strip() and not is_comment(line)]


def _sample(lines: Sequence[str]) -> list[str]:
    """Lines of the beginning, the middle and the end, from which the dialect is found."""
    if len(lines) <= 3 * EXAMINED_LINES:
        return _plain(lines)
    middle = len(lines) // 2 - EXAMINED_LINES // 2
    parts = (
        lines[:EXAMINED_LINES],
        lines[middle : middle + EXAMINED_LINES],
        lines[-EXAMINED_LINES:],
    )
    return [line for part in parts for line in _plain(part)]


EXAMINED_LINES = 300
"""Lines of each."""


def _open_ply(where: str, lines: list[str]) -> None:
    """Make the properties of the vertices of a PLY file its line of names; in place."""
    if lines[0].strip() != 'ply':
        return
    words = [line.split() for line in lines[:PLY_HEAD]]
    if not any(w[:2] == ['format', 'ascii'] for w in words) or ['end_header'] not in words:
        raise InputError(f'{where}: is not a PLY file in text form; write it as ascii')
    end = words.index(['end_header'])
    elements = [k for k in range(end) if words[k][:1] == ['element']]
    first = next((k for k in elements if words[k][1:2] == ['vertex']), None)
    if first is None or first != elements[0] or not words[first][-1].isdigit():
        raise InputError(
            f'{where}: PLY: the first element is not a vertex; write the points alone'
        )
    after = next((k for k in elements if k > first), end)
    names = [w[-1] for w in words[first:after] if w[:1] == ['property']]
    rows = int(words[first][-1])
    if len(lines) < end + 1 + rows or (rows and not lines[end + rows].strip()):
        raise InputError(
            f'{where}: PLY: the header states {rows} vertices, but the file contains fewer'
        )
    del lines[end + 1 + rows :]
    lines[: end + 1] = [*[''] * end, ' '.join(names)]


PLY_HEAD = 200
"""Lines."""


def is_comment(line: str) -> bool:
    """Return whether a line is a comment by its sign, and no datum such as #N/A or ***."""
    if not COMMENT.match(line):
        return False
    first = re.split(r'[\t;,|\s]', line.strip(), maxsplit=1)[0]
    if not first.strip('#'):  # '####' of a column that was too narrow, or '## A comment'
        return line.strip()[len(first) : len(first) + 1] not in ('\t', ';', ',', '|')
    return not is_missing(first.strip('"'))


def _is_named(line: str, is_head: IsHead | None) -> bool:
    fields = [_named_fields(line, dialect) for dialect in candidates()] if is_head else []
    return any(f and is_head is not None and is_head(f) for f in fields)


def _head_width(plain: Sequence[str], dialect: Dialect, is_head: IsHead) -> int:
    for line in plain[:HEAD_LINES]:
        fields = _named_fields(line, dialect)
        if fields and is_head(fields):
            return len(fields)
    return 0


HEAD_LINES = 100
"""Lines in which a head is looked for that decides between dialects."""


def _named_fields(line: str, dialect: Dialect) -> list[str]:
    """Fields of a line of names; empty if it is none."""
    if STATEMENT.match(line):
        return []
    fields = dialect.fields(_APART.sub(_together, line) if dialect.separator is None else line)
    is_none = len(fields) < MIN_NUMBER_COLUMNS or any(
        is_value(f) or (f and is_missing(f)) for f in fields
    )
    return [] if is_none else fields


_APART = re.compile(r'(?<=\S)[ \t]+[\[(]([^\s\])]*)[\])](?=\s|$)')
"""A unit in brackets after a name: 'X [mm] Y [mm]'."""


def _together(match: re.Match[str]) -> str:
    return match[0].lstrip() if is_unit(match[1]) else match[0]


@dataclass
class _Reader:
    """What is known while a file is read."""

    where: str
    every: list[str]
    dialect: Dialect
    is_head: IsHead | None
    faults: dict[int, str] = field(default_factory=dict)
    comments: dict[int, str] = field(default_factory=dict)
    signs: set[str] = field(default_factory=set)

    def table(self) -> TextTable:
        first = self._first_row()
        at, names = self._head(first)
        units = self._below(first, at)
        columns, lines = self._rows(first)
        names = self._fitting(names, columns, at)
        head = [COMMENT.sub('', line).strip() for line in self.every[:first]]
        return TextTable(
            self.where, columns, lines, [h for h in head if h], names, units, self.dialect,
            at + 1, self.comments, self.faults,
        )  # fmt: skip

    def _first_row(self) -> int:
        """Index of the first line that has the columns of the others, with numbers in them."""
        lame = None
        for k, line in enumerate(self.every):
            if not line.strip() or is_comment(line):
                continue
            fields = self.dialect.fields(line)
            if len(fields) != self.dialect.width:
                continue
            values = sum(map(is_value, fields))
            if values >= MIN_NUMBER_COLUMNS:
                return k
            if (
                lame is None
                and values
                and values + sum(map(is_missing, fields)) >= MIN_NUMBER_COLUMNS
            ):
                lame = k
        if lame is None:
            raise AssertionError('a dialect was found, so there is a row')
        return lame

    def _head(self, first: int) -> tuple[int, tuple[str, ...] | None]:
        """Index of the line of names, -1 if there is none, and the names."""
        if self.is_head is None:
            return -1, None
        misfit: tuple[int, tuple[str, ...]] | None = None
        for k in reversed(range(first)):
            line = self.every[k]
            comment = is_comment(line)
            text = COMMENT.sub('', line).strip('\r\n ') if comment else line
            for dialect in (self.dialect, *candidates()) if comment else (self.dialect,):
                fields = _named_fields(text, dialect)
                while len(fields) > self.dialect.width and not fields[-1]:
                    fields.pop()
                if not fields or not self.is_head(fields):
                    continue
                if len(fields) == self.dialect.width:
                    return k, self._grouped(fields, k)
                if misfit is None and (not comment or all(self._is_known(f) for f in fields)):
                    misfit = k, tuple(fields)
        return misfit or (-1, None)

    def _is_known(self, name: str) -> bool:
        """Return whether a word is a name in a head, and not one of a sentence."""
        return len(name.split()) == 1 and len(name) <= LONGEST_WORD

    def _grouped(self, names: Sequence[str], at: int) -> tuple[str, ...]:
        """Names with those of their groups, which stand in the lines right above."""
        grouped = list(names)
        for k in range(at - 1, max(at - 1 - GROUP_LINES, -1), -1):
            above = [] if is_comment(self.every[k]) else self.dialect.fields(self.every[k])
            if len(above) > self.dialect.width and not any(above[self.dialect.width :]):
                above = above[: self.dialect.width]
            if self.dialect.separator is None or len(above) != len(names):
                break
            group = ''
            for place, text in enumerate(above):
                group = text or group
                if group and not is_value(group):
                    grouped[place] = f'{group} {grouped[place]}'
        return tuple(grouped)

    def _below(self, first: int, at: int) -> tuple[str, ...]:
        """Units below the head; what else stands between head and data is a fault."""
        units: tuple[str, ...] = ()
        for k, line in enumerate(self.every[:first]):
            comment = COMMENT.match(line) if is_comment(line) else None
            text = COMMENT.sub('', line) if comment else line
            if comment:
                self.signs.add(comment[1])
                self.comments[k + 1] = text.strip()
            if k <= at or not line.strip():
                continue
            fields = self.dialect.fields(text)
            if self._are_units(fields):
                units = tuple(f.strip('[](){} ') for f in fields)
            elif not comment and self._is_datum(fields, line, headed=at >= 0):
                self.faults[k + 1] = self._misfit(fields)
        return units

    def _are_units(self, fields: Sequence[str]) -> bool:
        texts = [f.strip('[](){} ') for f in fields if f.strip('[](){} -')]
        return len(texts) >= MIN_NUMBER_COLUMNS and all(map(is_unit, texts))

    def _is_datum(self, fields: Sequence[str], line: str, *, headed: bool) -> bool:
        """Return whether a line before the first row is one of data with a fault."""
        if RULE.match(line) and len(fields) < self.dialect.width:
            return False
        if headed:
            return any(fields)
        values = [is_value(f) or is_missing(f) for f in fields]
        if len(fields) == 1:
            return values[0] and not fields[0].isdigit()  # a number of lines may stand first
        return any(values) and (len(fields) == self.dialect.width or all(values))

    def _misfit(self, fields: Sequence[str]) -> str:
        width = self.dialect.width
        if len(fields) == width:
            missing = next((f for f in fields if f and not is_value(f)), '')
            return f'{value_text(missing)} in place of a number' if missing else 'an empty field'
        if len(fields) == 1:
            return f'no line of {width} columns'
        return f'{len(fields)} columns instead of {width}'

    def _rows(self, first: int) -> tuple[list[list[str]], Sequence[int]]:
        """Columns from the first row on, with the numbers of their lines; faults of the others."""
        width, body = self.dialect.width, self.every[first:]
        while body and not any(self.dialect.fields(body[-1])):
            body.pop()  # empty lines, or lines of separators, after the data
        if SIGNED.search('\n'.join(body)) is None:
            columns = self.dialect.columns(body)
            if columns is not None:
                return columns, range(first + 1, first + 1 + len(body))
        rows, lines = [], []
        for number, line in enumerate(body, start=first + 1):
            if not line.strip():
                continue
            fields = self.dialect.fields(line)
            if line.lstrip().startswith(SIGNS) and self._is_comment_between(line, fields):
                self.comments[number] = COMMENT.sub('', line).strip()
                continue
            if len(fields) == width:
                rows.append(fields)
                lines.append(number)
            else:
                self.faults[number] = self._misfit(fields)
        return [[row[k] for row in rows] for k in range(width)], lines

    def _is_comment_between(self, line: str, fields: Sequence[str]) -> bool:
        match = COMMENT.match(line)
        if match is None or not is_comment(line):
            return False
        return match[1] in self.signs or len(fields) != self.dialect.width

    def _fitting(
        self, names: tuple[str, ...] | None, columns: list[list[str]], at: int
    ) -> tuple[str, ...] | None:
        """Refuse a head of another number of columns; a last one without a name is taken off."""
        width = self.dialect.width
        if names is None or len(names) == width:
            return names
        if len(names) == width - 1 and not any(text.strip() for text in columns[-1]):
            columns.pop()
            self.dialect = Dialect(self.dialect.separator, self.dialect.dated, width - 1)
            return names
        if len(names) == width - 1 and self.dialect.separator == ',' and _with_parts(columns):
            self.dialect = Dialect(self.dialect.separator, self.dialect.dated, width - 1)
            return names
        line = shortened(self.every[at].strip(), 80)
        raise InputError(
            f'{self.where}: the header (line {at + 1}) names {len(names)} columns, the lines have '
            f'{width}: {line!r}; correct the header, or omit it and name the columns with '
            f'--columns (a - leaves one out)'
        )


def _with_parts(columns: list[list[str]]) -> bool:
    """Join, in place, full seconds and a column of their parts, between which a comma stood.

    True if there is one such pair. The parts have one number of digits and begin again with every
    second, which no other column does.
    """
    pairs = [k for k in range(len(columns) - 1) if _are_parts(columns[k], columns[k + 1])]
    if len(pairs) != 1:
        return False
    k = pairs[0]
    parts = columns.pop(k + 1)
    columns[k] = [f'{a.strip()},{b.strip()}' for a, b in zip(columns[k], parts, strict=True)]
    return True


def _are_parts(whole: Sequence[str], parts: Sequence[str]) -> bool:
    if not SECONDS.search(whole[0]) or len(parts[0].strip()) not in (3, 6, 9):
        return False
    digits = [part.strip() for part in parts]
    if {len(part) for part in digits} != {len(digits[0])} or not all(map(str.isdigit, digits)):
        return False
    pairs = list(zip(whole, whole[1:], digits, digits[1:], strict=False))
    within = [b < d for a, c, b, d in pairs if a == c]
    turns = [d < b for a, c, b, d in pairs if a != c]
    return len(turns) > 1 and all(turns) and all(within)


SECONDS = re.compile(r':\d\d\s*$')
GROUP_LINES = 4
"""Lines above the head that may name groups of columns."""
LONGEST_WORD = 20
"""Letters."""

# SPDX-License-Identifier: Apache-2.0
"""A table in a text file: its delimiter, decimal sign, header and comments are found out.

A line of data has as many fields as most lines, and numbers where they have numbers. Lines before
the first of them may hold names and units of the columns; lines between that are none are skipped
and counted.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from otf_core.errors import InputError
from otf_core.files.writing import unreadable

COMMENT = re.compile(r'^\s*(#|//|!|%|"""|\*)+\s?')
DELIMITERS = ('\t', ';', ',', None)
"""In the order in which they are tried; None: any white space."""
NUMBER = re.compile(r'[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?$')
MOMENT = re.compile(r'.*\d:\d\d:\d\d([.,]\d+)?(\s?[AP]M|Z|[-+]\d\d:?\d\d)?$', re.I)
"""A time of day, with or without a date before it."""
APART = re.compile(r'\d\s+[-+.]?\d')
"""Two numbers in a field: commas between are those of decimals."""
LOOKED_AT = 200
"""Lines from which the form is found out."""
FEWEST = 3
"""Fields of a line of data at least."""
SKIPPED = 0.1
"""Share of lines after the first of data that may be none."""


@dataclass(frozen=True)
class TextTable:
    """A table as text.

    Attributes
    ----------
    where : str
        File name, for messages.
    rows : list of list of str
        Fields of the lines of data, quotes taken off.
    lines : list of int
        Number of each in the file, from 1.
    head : list of str
        Lines before them, without marks of comments.
    delimiter : str or None
    comma : bool
        Decimals are written with a comma.
    skipped : list of int
        Numbers of the lines that are no data.
    """

    where: str
    rows: list[list[str]]
    lines: list[int]
    head: list[str]
    delimiter: str | None
    comma: bool
    skipped: list[int]

    def number(self, text: str) -> str:
        """Return a number with a decimal point."""
        return text.replace(',', '.') if self.comma else text


def split(line: str, delimiter: str | None) -> list[str]:
    """Fields of a line, without quotes and white space around them."""
    fields = line.strip().split(delimiter)
    if delimiter is not None and fields and not fields[-1].strip():
        fields.pop()  # a delimiter at the end
    return [field.strip().strip('"').strip() for field in fields]


def is_value(text: str) -> bool:
    """Tell whether a field is a number or a time of day."""
    return bool(NUMBER.match(text) or MOMENT.match(text)) or text.lower() in ('nan', 'inf', '-inf')


def _decode(path: Path) -> str:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None
    if raw[:2] in (b'\xff\xfe', b'\xfe\xff'):
        return raw.decode('utf-16', 'replace')
    if b'\0' in raw[:4096]:
        raise InputError(f'{path}: is no text file; export the points as CSV or text')
    try:
        return raw.decode('utf-8-sig')
    except UnicodeDecodeError:
        return raw.decode('cp1252', 'replace')


def _form(lines: list[str]) -> tuple[str | None, int, tuple[bool, ...]] | None:
    """Delimiter, number of fields and which of them are values, as most lines have it."""
    best: tuple[int, str | None, int, tuple[bool, ...]] | None = None
    for delimiter in DELIMITERS:
        forms: Counter[tuple[int, tuple[bool, ...]]] = Counter()
        for line in lines:
            fields = split(line, delimiter)
            values = tuple(map(is_value, fields))
            if delimiter == ',' and any(APART.search(f) and not is_value(f) for f in fields):
                continue
            if sum(values) >= FEWEST:
                forms[len(fields), values] += 1
        if forms:
            (count, values), often = forms.most_common(1)[0]
            if best is None or often > best[0]:
                best = often, delimiter, count, values
    return None if best is None else best[1:]


def read_text_table(path: str | Path) -> TextTable:
    """Read a table.

    Raises
    ------
    ConfigError
        If the file cannot be read.
    InputError
        If it holds no table of numbers; says what was seen, and where.
    """
    where, text = str(path), _decode(Path(path))
    every = text.splitlines()
    plain = [line for line in every if line.strip() and not COMMENT.match(line)]
    found = _form(plain[-LOOKED_AT:]) or _form(plain[:LOOKED_AT])
    if found is None:
        first = next((line.strip()[:60] for line in every if line.strip()), '')
        raise InputError(
            f'{where}: holds no lines of at least {FEWEST} numbers; the first line is {first!r}; '
            f'export time, x, y, z of every sample, one sample a line'
        )
    delimiter, count, values = found
    rows, numbers, skipped = [], [], []
    head: list[str] = []
    for number, line in enumerate(every, start=1):
        fields = split(line, delimiter)
        if len(fields) == count and all(map(is_value, _chosen(fields, values))):
            rows.append(fields)
            numbers.append(number)
        elif not rows:
            head.append(COMMENT.sub('', line).strip())
        elif line.strip() and not COMMENT.match(line):
            skipped.append(number)
    if len(skipped) > SKIPPED * (len(rows) + len(skipped)):
        bad = every[skipped[0] - 1].strip()[:60]
        raise InputError(
            f'{where}: line {skipped[0]} is no line of {count} fields like most: {bad!r}; '
            f'{len(skipped)} of {len(rows) + len(skipped)} lines are like that: give one table a '
            f'file'
        )
    sample = [f for row in rows[:LOOKED_AT] for f in _chosen(row, values)]
    comma = delimiter != ',' and any(',' in f and ':' not in f for f in sample)
    return TextTable(where, rows, numbers, [h for h in head if h], delimiter, comma, skipped)


def _chosen(fields: list[str], values: tuple[bool, ...]) -> list[str]:
    return [f for f, is_one in zip(fields, values, strict=True) if is_one]

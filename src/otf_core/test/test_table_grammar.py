# SPDX-License-Identifier: Apache-2.0
"""Any accepted form of a table gives the same points bit for bit; a damaged one never others."""

from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip('hypothesis', reason='pip install -r requirements/dev.txt')
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from otf_core.errors import OtfError
from otf_core.inputs.path_file import read_points
from otf_core.inputs.text_points import TextReading

TRIED = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
HEADS = (
    ('time_s', 'x_mm', 'y_mm', 'z_mm'),
    ('Zeit [s]', 'X [mm]', 'Y [mm]', 'Z [mm]'),
    ('t (s)', 'Xist (mm)', 'Yist (mm)', 'Zist (mm)'),
)
MISSING = ('', 'n/a', '#N/A', '#DIV/0!', '---', '***', 'NULL', '?')


@dataclass(frozen=True)
class Form:
    """How a table is written."""

    separator: str
    mark: str
    quoted: bool
    head: tuple[str, ...]
    above: str
    trailing: bool
    end: str
    last_end: bool
    encoding: str

    def number(self, text):
        """A decimal number in this form."""
        sign, digits = ('-', text[1:]) if text.startswith('-') else ('', text)
        whole, _, part = digits.partition('.')
        return f'{sign}{whole}{self.mark if part else ""}{part}'

    def line(self, fields):
        """Fields in a line."""
        shown = [f'"{f}"' if self.quoted else f for f in fields]
        return self.separator.join(shown) + self.separator * self.trailing

    def file(self, path, lines):
        """Write a file."""
        head = [self.above] if self.above else []
        text = self.end.join([*head, self.line(self.head), *lines]) + self.end * self.last_end
        path.write_bytes(text.encode(self.encoding))


@st.composite
def forms(draw):
    """Forms that are accepted."""
    separator = draw(st.sampled_from(['\t', ';', ',', '|', '  ', ' ; ']))
    mark = draw(st.sampled_from('.,'))
    quoted = draw(st.booleans())
    assume(quoted or ',' not in separator or mark != ',')
    assume(not (quoted and separator == ' ; '))
    head = draw(st.sampled_from(HEADS))
    if separator == '  ' and not quoted:
        head = HEADS[0]
    encoding = draw(st.sampled_from(['utf-8', 'utf-8-sig', 'utf-16']))
    above = draw(st.sampled_from(['', '# Bericht', 'Take;1']))
    return Form(
        separator, mark, quoted, head, above,
        separator.strip() != '' and draw(st.booleans()), draw(st.sampled_from(['\n', '\r\n'])),
        draw(st.booleans()), encoding,
    )  # fmt: skip


@st.composite
def tables(draw):
    """Texts of times and points: rows of decimal numbers with a point."""
    digits = draw(st.sampled_from([1, 2, 4]))
    numbers = st.integers(-(10**8), 10**8).map(lambda v: f'{v / 10**digits:.{digits}f}')
    rows = draw(st.lists(st.tuples(numbers, numbers, numbers), min_size=11, max_size=20))
    return [[f'{0.25 * k:.{digits + (digits == 1)}f}', *row] for k, row in enumerate(rows)]


def samples(path):
    """Points of a text of samples."""
    return TextReading(path).received().xyz


def clean(rows, path):
    """What the plain table gives."""
    path.write_text('\n'.join([','.join(HEADS[0]), *map(','.join, rows)]) + '\n')
    return samples(path)


@given(rows=tables(), form=forms())
@TRIED
def test_any_form_gives_the_same_points_bit_for_bit(tmp_path, rows, form):
    wanted = clean(rows, tmp_path / 'clean.csv')
    form.file(tmp_path / 'a.csv', [form.line(map(form.number, row)) for row in rows])
    np.testing.assert_array_equal(samples(tmp_path / 'a.csv'), wanted)
    np.testing.assert_array_equal(read_points(tmp_path / 'a.csv')[0], wanted)


@st.composite
def damages(draw):
    """A row, counted from its end, and what is done to its fields and its line."""
    return (
        draw(st.integers(0, 10)), draw(st.integers(0, 3)),
        draw(st.sampled_from(['field', 'cut', 'separator', 'group', 'missing', 'twice'])),
        draw(st.sampled_from(MISSING)), draw(st.sampled_from('\t;,|')),
    )  # fmt: skip


def spoilt(form, fields, damage):
    """The line of a row, damaged."""
    _, place, kind, missing, other = damage
    if kind == 'field':
        return form.line([f for k, f in enumerate(fields) if k != place])
    if kind == 'cut':
        return form.line(fields).rsplit(form.separator, 1 + form.trailing + place % 2)[0]
    if kind == 'separator':
        return form.line(fields).replace(form.separator, other)
    if kind == 'twice':
        return form.line([*fields[: place + 1], *fields[place:]])
    if kind == 'missing':
        return form.line([missing if k == place else f for k, f in enumerate(fields)])
    sign, digits = ('-', fields[place][1:]) if fields[place][0] == '-' else ('', fields[place])
    field = f"{sign}{digits[:1]}'{digits[1:]}"
    return form.line([field if k == place else f for k, f in enumerate(fields)])


@given(rows=tables(), form=forms(), damage=damages())
@TRIED
def test_a_damaged_table_never_gives_other_points(tmp_path, rows, form, damage):
    row, place, kind, missing, other = damage
    fields = [[form.number(text) for text in each] for each in rows]
    row = len(rows) - 1 - row
    blank = form.separator.isspace() and other.isspace()  # white space is one separator
    assume(kind != 'separator' or not (blank or other in form.separator))
    assume(kind != 'missing' or missing or form.quoted or form.separator != '  ')
    lines = [form.line(each) for each in fields]
    lines[row] = spoilt(form, fields[row], damage)
    assume(lines[row].strip())
    wanted = np.delete(clean(rows, tmp_path / 'clean.csv'), row, axis=0)
    form.file(tmp_path / 'a.csv', lines)
    try:
        got = samples(tmp_path / 'a.csv')
    except OtfError as error:
        assert 'a.csv' in str(error)
    else:
        np.testing.assert_array_equal(got, wanted)
    if place or kind not in ('missing', 'group'):  # in the column of times, which points lack
        with pytest.raises(OtfError, match=r'a\.csv'):
            read_points(tmp_path / 'a.csv')

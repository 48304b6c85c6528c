# SPDX-License-Identifier: Apache-2.0
"""Times of texts: read to the nanosecond, or refused with the option that reads them."""

import re
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from otf_core.bags.bag import points_of
from otf_core.errors import InputError
from otf_core.files.text_times import TimeTextError, form_hint, read_times
from otf_core.inputs.recordings import ReadingOptions, open_reading
from otf_core.inputs.text_points import TextReading

S = 1_000_000_000
COUNT, STEP = 400, 40_000_000
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
LATE = datetime(2026, 1, 31, 23, 59, 52, tzinfo=timezone.utc)
"""Over midnight and the end of a month."""
MOMENTS = [LATE + timedelta(microseconds=k * STEP // 1000) for k in range(COUNT)]


def ns(moment):
    return (moment - EPOCH) // timedelta(microseconds=1) * 1000


NS = np.array([ns(m) for m in MOMENTS])
FORMS = {
    'ISO': (None, lambda m: f'{m:%Y-%m-%dT%H:%M:%S.%f}Z'),
    'ISO, comma': (None, lambda m: f'{m:%Y-%m-%d %H:%M:%S},{m.microsecond // 1000:03d}'),
    'UTC': (None, lambda m: f'{m:%Y-%m-%d %H:%M:%S.%f} UTC'),
    'offset': (None, lambda m: f'{m + timedelta(hours=5.5):%Y-%m-%d %H:%M:%S.%f}+05:30'),
    'time of day': (None, lambda m: f'{m:%H:%M:%S.%f}'),
    'points': ('%d.%m.%Y %H:%M:%S,%f', lambda m: f'{m:%d.%m.%Y %H:%M:%S,%f}'),
    'strokes': ('%m/%d/%Y %I:%M:%S.%f %p', lambda m: f'{m:%m/%d/%Y %I:%M:%S.%f %p}'),
    'asctime': ('%a %b %d %H:%M:%S.%f %Y', lambda m: f'{m:%a %b} {m.day:2d} {m:%H:%M:%S.%f %Y}'),
    'year first': ('%y-%m-%d %H:%M:%S.%f', lambda m: f'{m:%y-%m-%d %H:%M:%S.%f}'),
    'day of the year': ('%Y-%jT%H:%M:%S.%f', lambda m: f'{m:%Y-%jT%H:%M:%S.%f}'),
    'one number': ('%Y%m%d%H%M%S%f', lambda m: f'{m:%Y%m%d%H%M%S}{m.microsecond // 1000:03d}'),
    'zone': ('%d.%m.%Y %H:%M:%S.%f %z', lambda m: f'{m:%d.%m.%Y %H:%M:%S.%f} +0000'),
    'milliseconds behind a colon': ('%H:%M:%S:%f', lambda m: f'{m:%H:%M:%S:%f}'),
    'half days': ('%I:%M:%S.%f %p', lambda m: f'{m:%I:%M:%S.%f %p}'),
}


@pytest.mark.parametrize(('form', 'text'), FORMS.values(), ids=FORMS)
def test_dates_and_times_are_read_to_the_nanosecond(form, text):
    got, _ = read_times(list(map(text, MOMENTS)), None, form)
    if text(LATE)[2] == ':':  # without a date
        got += NS[0] - got[0]
    np.testing.assert_array_equal(got, NS)


@pytest.mark.parametrize(
    ('form', 'text'),
    [(None, '2026-01-31T23:59:52.{}'), ('%d/%m/%Y %H:%M:%S.%f', '31/01/2026 23:59:52.{}')],
)
def test_nine_digits_of_a_second_are_read_without_loss(form, text):
    got, _ = read_times(
        [text.format(digits) for digits in ('123456789', '5', '000000001')], '', form
    )
    np.testing.assert_array_equal(got - ns(LATE), [123_456_789, 500_000_000, 1])


@pytest.mark.parametrize(
    ('text', 'form'),
    [
        ('14.03.2026 09:30:00,25', '%d.%m.%Y %H:%M:%S,%f'),
        ('03/14/26 9:30:00 AM', '%m/%d/%y %I:%M:%S %p'),
        ('03/04/2026 9:30:00', '%m/%d/%Y %H:%M:%S'),
        ('03/04/2026 9:30:00', '%d/%m/%Y %H:%M:%S'),
        ('26-01-31 9:30:00', '%y-%m-%d %H:%M:%S'),
        ('Sat Mar 14 09:30:00 2026', '%a %b %d %H:%M:%S %Y'),
        ('14-Mar-2026 09:30:00', '%d-%b-%Y %H:%M:%S'),
        ('2026/03/14 09:30:00.5', '%Y/%m/%d %H:%M:%S.%f'),
        ('13:15:01:25', '%H:%M:%S:%f'),
        ('20260314T093000', '%d.%m.%Y %H:%M:%S.%f'),
        ('noon', '%d.%m.%Y %H:%M:%S.%f'),
    ],
)
def test_another_form_is_refused_with_the_option_that_reads_it(text, form):
    with pytest.raises(TimeTextError, match='ISO 8601') as refused:
        read_times(['2026-03-14 10:00:00', text])
    assert refused.value.row == 1 and repr(text) in str(refused.value)
    assert f'--time-format "{form}"' in form_hint(text)


@pytest.mark.parametrize(
    ('texts', 'form', 'said'),
    [
        (['25:10:00'], None, 'of day'),
        (['2026-02-30 10:00:00'], None, 'day'),
        (['10:00:00', '2026-03-14 10:00:01'], None, 'date'),
        (['2026-03-14 10:00:00', '10:00:01'], None, 'date'),
        (
            ['31/01/2026 10:00:00', '01/31/2026 10:00:01'],
            '%d/%m/%Y %H:%M:%S',
            r'01/31.*of the form',
        ),
        (['0', 'x'], None, "'x' is not a number"),
        (['1e300'], None, 'does not fit into 64 bits'),
    ],
)
def test_what_is_no_time_is_refused_by_name(texts, form, said):
    with pytest.raises(TimeTextError, match=said) as refused:
        read_times(texts, None, form)
    assert 'fit' in said or refused.value.row == len(texts) - 1


@pytest.mark.parametrize(
    ('first', 'step', 'units'),
    [
        (0, '0.04', 's'),
        (0, '40', 'ms'),
        (1_696_508_620, '1', 's'),
        (1_696_508_620_000, '40', 'ms'),
        (1_696_508_620_000_000_000, '40000000', 'ns'),
        (0, '1', 's ms'),
        (0, '1000', 'ms us'),
        (0, '0', 's ms us ns'),
    ],
)
def test_a_unit_of_time_is_taken_where_there_is_one_alone(first, step, units):
    texts = [
        f'{first + k * float(step):.9g}' if first < 9 else f'{first + k * int(step)}'
        for k in range(9)
    ]
    if ' ' not in units:
        power = {'s': 9, 'ms': 6, 'ns': 0}[units]
        got, words = read_times(texts)
        assert words == f'{units} (not stated, by their size)'
        np.testing.assert_array_equal(
            got - got[0], np.rint(float(step) * 10.0**power * np.arange(9))
        )
        return
    with pytest.raises(TimeTextError, match='is not stated') as refused:
        read_times(texts)
    assert refused.value.units == tuple(units.split())


# ---------------------------------------------------------------- in tables

ALONG = np.abs((0.006 * np.arange(COUNT) + 0.1) % 0.6 - 0.3)
XYZ = np.stack([1.0 + ALONG, 0.5 * ALONG - 2.0, 0.3 + 0 * ALONG], axis=1)


def table(tmp_path, stamps, head='time;x_mm;y_mm;z_mm'):
    rows = [
        ';'.join([t, *(f'{1e3 * v:.4f}' for v in p)]) for t, p in zip(stamps, XYZ, strict=True)
    ]
    (tmp_path / 'run.csv').write_text('\n'.join([head, *rows, '']), encoding='utf-8')
    return tmp_path / 'run.csv'


@pytest.mark.parametrize(('unit', 'seconds'), [('min', 60), ('h', 3600), ('days', 86400)])
@pytest.mark.parametrize('head', ['time [{}]', 'Zeit ({})', 'time_{}'])
def test_long_units(tmp_path, unit, seconds, head):
    stamps = [f'{0.04 * k / seconds:.12f}' for k in range(COUNT)]
    got = TextReading(table(tmp_path, stamps, f'{head.format(unit)};x_mm;y_mm;z_mm')).received()
    np.testing.assert_allclose(got.stamp_ns, STEP * np.arange(COUNT), atol=100)


def test_the_option_in_a_message_reads_the_table(tmp_path):
    file = table(tmp_path, [f'{m:%d/%m/%Y %H:%M:%S.%f}' for m in MOMENTS])
    with pytest.raises(
        InputError, match=r"run.csv: line 2: time: '31/01/2026 23:59:52"
    ) as refused:
        TextReading(file)
    (form,) = re.findall(r'--time-format "([^"]+)"', str(refused.value))
    samples = points_of(open_reading(file, ReadingOptions(time_format=form)), file)
    np.testing.assert_array_equal(samples.stamp_ns, NS)
    with pytest.raises(InputError, match=r'line 2: time: .* is not a time of the form %m/%d/%Y'):
        TextReading(file, time_format='%m/%d/%Y %H:%M:%S.%f')


def test_date_and_time_in_two_columns(tmp_path):
    stamps = [f'{m:%d.%m.%Y;%H:%M:%S.%f}' for m in MOMENTS]
    file = table(tmp_path, stamps, 'Datum;Zeit;x_mm;y_mm;z_mm')
    with pytest.raises(InputError, match=r'--time-format "%d\.%m\.%Y'):
        TextReading(file)
    for columns in (None, 'date,time,x_mm,y_mm,z_mm'):
        got = TextReading(file, columns, time_format='%d.%m.%Y %H:%M:%S.%f').received()
        np.testing.assert_array_equal(got.stamp_ns, NS)

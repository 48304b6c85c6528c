# SPDX-License-Identifier: Apache-2.0
"""Times of texts: dates by one rule a file, every form read or refused by name, repairs."""

import random
import re
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from otf_core.bags.bag import points_of
from otf_core.errors import InputError
from otf_core.files.text_moments import ZONES, MomentError, is_moment, read_moments
from otf_core.inputs.recordings import ReadingOptions, open_reading
from otf_core.inputs.text_points import TextReading

S = 1_000_000_000
COUNT, STEP = 400, 40_000_000
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def ns(moment):
    return (moment - EPOCH) // timedelta(microseconds=1) * 1000


def moments(start, count=COUNT, step=STEP):
    return [start + timedelta(microseconds=k * step // 1000) for k in range(count)]


LATE = datetime(2026, 1, 31, 23, 59, 52, tzinfo=timezone.utc)
"""Over midnight and the end of a month, days above 12 before it and below after it."""
NOON = datetime(2025, 11, 24, 11, 59, 52, 500_000, tzinfo=timezone.utc)
MONTHS = {
    'en': 'January February March April May June July August September October November December',
    'de': 'Januar Februar März April Mai Juni Juli August September Oktober November Dezember',
    'fr': 'janvier février mars avril mai juin juillet août septembre octobre novembre décembre',
    'es': 'enero febrero marzo abril mayo junio julio agosto septiembre octubre noviembre '
    'diciembre',
    'it': 'gennaio febbraio marzo aprile maggio giugno luglio agosto settembre ottobre novembre '
    'dicembre',
}


def part(m, digits=6):
    return f'{m.microsecond:06d}'[:digits]


def day(m):
    return m.timetuple().tm_yday


DATED = {
    'ISO': lambda m: f'{m:%Y-%m-%dT%H:%M:%S}.{part(m)}Z',
    'ISO, comma': lambda m: f'{m:%Y-%m-%d %H:%M:%S},{part(m, 3)}',
    'year first, strokes': lambda m: f'{m:%Y/%m/%d %H:%M:%S}.{part(m, 3)}',
    'UTC': lambda m: f'{m:%Y-%m-%d %H:%M:%S}.{part(m)} UTC',
    'GMT': lambda m: f'{m:%Y-%m-%d %H:%M:%S}.{part(m)} GMT',
    'offset': lambda m: f'{m + timedelta(hours=5, minutes=30):%Y-%m-%d %H:%M:%S}.{part(m)}+05:30',
    'offset of UTC': lambda m: f'{m - timedelta(hours=5):%Y-%m-%d %H:%M:%S}.{part(m)} UTC-5',
    'time zone': lambda m: f'{m + timedelta(hours=1):%d.%m.%Y %H:%M:%S}.{part(m)} CET',
    'day first, strokes': lambda m: f'{m:%d/%m/%Y %H:%M:%S}.{part(m)}',
    'day first, dashes': lambda m: f'{m:%d-%m-%Y %H:%M:%S}.{part(m)}',
    'day first, points': lambda m: f'{m:%d.%m.%Y %H:%M:%S},{part(m, 3)}',
    'month first': lambda m: f'{m:%m/%d/%Y %I:%M:%S}.{part(m)} {m:%p}',
    'month first, a. m.': lambda m: f'{m:%m/%d/%Y %I:%M:%S}.{part(m)} {"ap"[m.hour > 11]}. m.',
    'month first, narrow space': lambda m: f'{m:%m/%d/%Y, %I:%M:%S}.{part(m)}\u202f{m:%p}',
    'asctime': lambda m: f'{m:%a %b %d %H:%M:%S}.{part(m)} {m:%Y}',
    'asctime, padded': lambda m: f'{m:%a %b} {m.day:2d} {m:%H:%M:%S}.{part(m)} {m:%Y}',
    'RFC 2822': lambda m: f'{m:%a, %d %b %Y %H:%M:%S}.{part(m)} +0000',
    'name of the month': lambda m: f'{m:%d-%b-%Y %H:%M:%S}.{part(m)}',
    'name of the month first': lambda m: f'{m:%B} {m.day}, {m:%Y %I:%M:%S}.{part(m)} {m:%p}',
    'day of the year': lambda m: f'{m:%Y}-{day(m):03d}T{m:%H:%M:%S}.{part(m)}Z',
    'day of the year, colons': lambda m: f'{m:%Y}:{day(m):03d}:{m:%H:%M:%S}.{part(m)}',
    'compact': lambda m: f'{m:%Y%m%dT%H%M%S}.{part(m, 3)}',
    'compact, Z': lambda m: f'{m:%Y%m%dT%H%M%S}.{part(m, 3)}Z',
    'compact, underscore': lambda m: f'{m:%Y%m%d_%H%M%S}.{part(m, 3)}',
    'one number': lambda m: f'{m:%Y%m%d%H%M%S}.{part(m, 3)}',
    'one number, milliseconds': lambda m: f'{m:%Y%m%d%H%M%S}{part(m, 3)}',
} | {
    f'months in {language}': lambda m, language=language: (
        f'{m.day}. {MONTHS[language].split()[m.month - 1]} {m:%Y %H:%M:%S}.{part(m)}'
    )
    for language in MONTHS
}  # fmt: skip
UNDATED = {
    'time of day': lambda m: f'{m:%H:%M:%S}.{part(m)}',
    'time of day, comma': lambda m: f'{m:%H:%M:%S},{part(m, 3)}',
    'half days': lambda m: f'{m:%I:%M:%S}.{part(m)} {m:%p}',
    'half days, a.m.': lambda m: f'{m:%I:%M:%S}.{part(m)} {"ap"[m.hour > 11]}.m.',
    'milliseconds behind a colon': lambda m: f'{m:%H:%M:%S}:{part(m, 3)}',
    'day of the year alone': lambda m: f'{day(m):03d}:{m:%H:%M:%S}.{part(m)}',
    'day counted on': lambda m: f'{m:%H:%M:%S}.{part(m)} CEST',
}


@pytest.mark.parametrize('form', DATED.values(), ids=DATED)
@pytest.mark.parametrize('start', [LATE, NOON], ids=['over midnight', 'over noon'])
def test_dates_and_times_are_read_to_the_nanosecond(form, start):
    times = moments(start)
    texts = [form(m) for m in times]
    assert all(map(is_moment, texts)) or texts[0][:14].isdigit()
    np.testing.assert_array_equal(read_moments(texts).stamp_ns, [ns(m) for m in times])


@pytest.mark.parametrize('form', UNDATED.values(), ids=UNDATED)
@pytest.mark.parametrize('start', [LATE, NOON], ids=['over midnight', 'over noon'])
def test_times_without_a_date_go_on(form, start):
    got = read_moments([form(m) for m in moments(start)]).stamp_ns
    np.testing.assert_array_equal(got - got[0], STEP * np.arange(COUNT))


@pytest.mark.parametrize('zone', ZONES)
def test_time_zones(zone):
    (got,) = read_moments([f'2026-03-14 09:30:00 {zone}']).stamp_ns
    assert got == ns(datetime(2026, 3, 14, 9, 30, tzinfo=timezone.utc)) - 3600 * S * ZONES[zone]


# ---------------------------------------------------------------- dates by one rule

AMBIGUOUS = {
    '11/02/2026 10:00:00': ('2026-02-11 (day, month, year)', '2026-11-02 (month, day, year)'),
    '11-02-2026 10:00:00': ('2026-02-11 (day, month, year)', '2026-11-02 (month, day, year)'),
    '26-01-31 10:00:00': ('2031-01-26 (day, month, year)', '2026-01-31 (year, month, day)'),
    '31-01-26 10:00:00': ('2026-01-31 (day, month, year)', '2031-01-26 (year, month, day)'),
    '26.01.31 10:00:00': ('2031-01-26 (day, month, year)', '2026-01-31 (year, month, day)'),
}


@pytest.mark.parametrize('text', AMBIGUOUS)
def test_dates_of_two_readings_are_refused_with_both(text):
    with pytest.raises(MomentError) as refused:
        read_moments([text])
    assert all(reading in str(refused.value) for reading in AMBIGUOUS[text])
    different = {int(read_moments([text], order).stamp_ns[0]) for order in refused.value.orders}
    assert len(different) == 2


def test_the_rule_is_found_anywhere_in_the_file():
    texts = ['01/02/2026 23:59:59', '02/02/2026 00:00:01']  # as month first a month passes
    assert np.diff(read_moments(texts).stamp_ns) == [2 * S]
    texts = ['12/12/2026 23:59:59', '13/12/2026 00:00:01']
    assert np.diff(read_moments(texts).stamp_ns) == [2 * S]
    assert read_moments(['12/12/2026 10:00:00']).stamp_ns.size  # one day in both readings


def test_dates_that_no_rule_fits_are_refused():
    with pytest.raises(MomentError, match=r'no order of .* fits all lines$'):
        read_moments(['31/01/2026 10:00:00', '01/31/2026 10:00:01'])
    with pytest.raises(MomentError, match=r'no order .* fits all lines \(mdy was requested\)'):
        read_moments(['31/01/2026 10:00:00'], 'mdy')


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('13:15:01:25', 'frames or milliseconds'),
        ('1:02:03:04', 'frames or milliseconds'),
        ('2026-03-14 13:15:01 CST', 'time zone CST'),
        ('25:10:00', 'is not a time of day'),
        ('13:15:01 PM', 'is not a time of day'),
        ('13:61:01', 'is not a time'),
        ('2026-02-30 10:00:00', 'has a day that does not exist'),
        ('2026-03-14 13:15.5', 'has decimals of a minute'),
        ('14 Nov 13:15:01', 'date without a year'),
        ('14 Foo 2026 13:15:01', 'names no month'),
        ('2026-400 10:00:00', 'has no day of a year'),
        ('-01:00:00', 'is not a time'),
        ('noon', 'is not a time'),
    ],
)
def test_what_is_no_time_is_refused_by_name(text, said):
    good = '2026-03-14 10:00:00' if '20' in text else '10:00:00'
    with pytest.raises(MomentError, match=said) as refused:
        read_moments([good, text])
    assert refused.value.row == 1 and repr(text) in str(refused.value)


def test_one_form_a_column():
    for texts in (
        ['10:00:00', '2026-03-14 10:00:01'],
        ['2026-03-14 10:00:00', '10:00:01'],
        ['10:00:00', '10:01.5'],
        ['10:00:00:100', '10:00:00.2'],
    ):
        with pytest.raises(MomentError) as refused:
            read_moments(texts)
        assert refused.value.row == 1


# ---------------------------------------------------------------- in tables


def track(count=COUNT, rate=25.0):
    """A target that goes forth and back at 0.15 m/s."""
    along = np.abs((0.15 / rate * np.arange(count) + 0.1) % 0.6 - 0.3)
    xyz = np.stack([1.0 + along, 0.5 * along - 2.0, 0.3 + 0 * along], axis=1)
    return (xyz + np.random.default_rng(3).normal(0, 3e-6, xyz.shape)).round(7)


XYZ = track()


def table(tmp_path, stamps, head='time;x_mm;y_mm;z_mm', xyz=XYZ):
    rows = [
        ';'.join([t, *(f'{1e3 * v:.4f}' for v in p)]) for t, p in zip(stamps, xyz, strict=True)
    ]
    (tmp_path / 'run.csv').write_text('\n'.join([head, *rows, '']), encoding='utf-8')
    return tmp_path / 'run.csv'


def since_of(file, **options):
    got = TextReading(file, **options)
    raw = got.received()
    return raw.stamp_ns - raw.stamp_ns[0], got


TIMES = moments(LATE)
NUMBERS = {
    'days of a spreadsheet': lambda m: f'{ns(m) / S / 86400 + 25569:.11f}',
    'days of MATLAB': lambda m: f'{(ns(m) // 1000) / 8.64e10 + 719529:.10f}',
    'part of a day': lambda m: f'{(ns(m) - ns(LATE)) / S / 86400:.12f}',
}


@pytest.mark.parametrize('form', NUMBERS.values(), ids=NUMBERS)
def test_days_are_known_by_the_speed(tmp_path, form):
    since, got = since_of(table(tmp_path, map(form, TIMES)))
    np.testing.assert_allclose(since, STEP * np.arange(COUNT), atol=2e4)
    assert 'time from time in days' in got.said[0]


def test_the_date_of_a_spreadsheet(tmp_path):
    file = table(tmp_path, map(NUMBERS['days of a spreadsheet'], TIMES))
    assert abs(int(TextReading(file).received().stamp_ns[0]) - ns(LATE)) < 1_000_000


@pytest.mark.parametrize(('unit', 'seconds'), [('min', 60), ('h', 3600), ('days', 86400)])
@pytest.mark.parametrize('head', ['time [{}]', 'Zeit ({})'])
def test_long_units(tmp_path, unit, seconds, head):
    stamps = [f'{0.04 * k / seconds:.12f}' for k in range(COUNT)]
    head = f'{head.format(unit)};x_mm;y_mm;z_mm'
    since, _ = since_of(table(tmp_path, stamps, head))
    np.testing.assert_allclose(since, STEP * np.arange(COUNT), atol=100)


def test_minutes_and_seconds_of_a_spreadsheet(tmp_path):
    stamps = [
        f'{59 + int(k * 0.04 + 52) // 60:02d}:{(k * 0.04 + 52) % 60:06.3f}' for k in range(COUNT)
    ]
    wrapped = [f'{int(t[:2]) % 60:02d}{t[2:]}' for t in stamps]
    file = table(tmp_path, wrapped)
    assert 'minutes and seconds' in TextReading(file).said[0]
    samples = points_of(open_reading(file, ReadingOptions()), file)
    np.testing.assert_array_equal(samples.stamp_ns - samples.stamp_ns[0], STEP * np.arange(COUNT))


def test_hours_and_decimal_minutes(tmp_path):
    stamps = [f'09:{30 + k * 0.04 / 60:09.6f}' for k in range(COUNT)]
    since, got = since_of(table(tmp_path, stamps))
    np.testing.assert_allclose(since, STEP * np.arange(COUNT), atol=1e5)
    assert 'hours and minutes (not stated, by the speed)' in got.said[0]


def test_a_time_of_day_as_one_number(tmp_path):
    since, got = since_of(table(tmp_path, [f'{m:%H%M%S}.{part(m, 3)}' for m in moments(NOON)]))
    np.testing.assert_array_equal(since, STEP * np.arange(COUNT))
    assert 'as one number' in got.said[0]


def test_seconds_of_six_digits_stay_seconds(tmp_path):
    stamps = [f'{131_430 + 0.04 * k:.2f}' for k in range(2 * COUNT)]  # passes 131461 to 131499 too
    since, got = since_of(table(tmp_path, stamps, xyz=track(2 * COUNT)))
    np.testing.assert_array_equal(since, STEP * np.arange(2 * COUNT))
    assert 's (not stated' in got.said[0]


@pytest.mark.parametrize('form', ['one number', 'compact', 'asctime', 'RFC 2822', 'UTC'])
def test_moments_in_a_table(tmp_path, form):
    since, _ = since_of(table(tmp_path, map(DATED[form], TIMES)))
    np.testing.assert_array_equal(since, STEP * np.arange(COUNT))


@pytest.mark.parametrize('head', ['time;x_mm;y_mm;z_mm', 'Time [s];X [mm];Y [mm];Z [mm]'])
@pytest.mark.parametrize(('places', 'power'), [(9, -9), (6, -6), (3, -3)])
def test_leading_zeros_that_were_lost_are_put_back(tmp_path, head, places, power):
    at = 1_696_508_620 * S + STEP * np.arange(COUNT) + 4_000_000
    stamps = [f'{t // S}.{t % S // 10 ** (9 - places)}' for t in at.tolist()]
    since, got = since_of(table(tmp_path, stamps, head))
    np.testing.assert_array_equal(since, STEP * np.arange(COUNT))
    assert f'10^{power} s, which had lost their leading zeros' in got.said[0]


def test_leading_zeros_lost_from_times_of_day(tmp_path):
    stamps = [f'{m:%H:%M:%S}.{m.microsecond}' for m in moments(NOON)]
    since, got = since_of(table(tmp_path, stamps))
    np.testing.assert_array_equal(since, STEP * np.arange(COUNT))
    assert 'which had lost their leading zeros' in got.said[0]


def test_decimals_without_trailing_zeros_are_decimals(tmp_path):
    stamps = [f'{1000 + 0.04 * k:.2f}'.rstrip('0').rstrip('.') for k in range(COUNT)]
    since, got = since_of(table(tmp_path, stamps))
    np.testing.assert_array_equal(since, STEP * np.arange(COUNT))
    assert 'zeros' not in got.said[0]


def test_an_ambiguous_date_names_its_column_and_the_cure_works(tmp_path):
    start = datetime(2026, 2, 11, 10, tzinfo=timezone.utc)
    file = table(tmp_path, [f'{m:%d/%m/%Y %H:%M:%S}.{part(m)}' for m in moments(start)])
    with pytest.raises(InputError, match=r"run.csv: time: '11/02/2026' may be ") as refused:
        TextReading(file)
    cures = re.findall(r'--columns ([^ ;]+)', str(refused.value))
    assert [cure[:9] for cure in cures] == ['time_dmy,', 'time_mdy,']
    other = datetime(2026, 11, 2, 10, tzinfo=timezone.utc)
    for cure, want in zip(cures, (start, other), strict=True):
        _, got = since_of(file, columns=cure)
        assert got.received().stamp_ns[0] == ns(want)


def test_a_bad_time_is_named_by_its_line(tmp_path):
    stamps = [f'{m:%H:%M:%S}.{part(m)}' for m in moments(NOON)]
    stamps[7] = '11:59:61.0 XX'
    with pytest.raises(InputError, match=r"line 9: time: '11:59:61.0 XX' is not a time"):
        TextReading(table(tmp_path, stamps))


def split_by_commas(tmp_path, digits, number=False, count=COUNT):
    """A table between commas whose times hold one too, or a number of the sample behind them."""
    rows = []
    for k, (m, p) in enumerate(zip(moments(LATE, count), XYZ, strict=False)):
        behind = str(100 + k) if number else part(m, digits)
        rows.append(f'{m:%Y-%m-%d %H:%M:%S},{behind},{",".join(f"{1e3 * v:.4f}" for v in p)}')
    (tmp_path / 'run.csv').write_text('\n'.join(['time,x_mm,y_mm,z_mm', *rows, '']))
    return tmp_path / 'run.csv'


@pytest.mark.parametrize('digits', [3, 6])
def test_a_comma_before_the_milliseconds_between_commas(tmp_path, digits):
    since, got = since_of(split_by_commas(tmp_path, digits))
    np.testing.assert_array_equal(since, STEP * np.arange(COUNT))
    np.testing.assert_allclose(got.received().xyz, XYZ, atol=1e-7)


def test_a_number_behind_the_time_is_none_of_its_parts(tmp_path):
    with pytest.raises(InputError, match='names 4 columns, the lines have 5'):
        TextReading(split_by_commas(tmp_path, 3, number=True))
    with pytest.raises(InputError, match='names 4 columns, the lines have 5'):
        TextReading(split_by_commas(tmp_path, 3, count=20))  # within a second there is no telling


@pytest.mark.parametrize('seed', range(40))
def test_any_form_of_any_moment_is_that_moment(seed):
    rng = random.Random(seed)
    start = datetime(
        rng.randint(2000, 2049), rng.randint(1, 12), rng.randint(13, 28), rng.randint(0, 23),
        rng.randint(0, 59), rng.randint(0, 59), 1000 * rng.randint(0, 999), tzinfo=timezone.utc,
    )  # fmt: skip
    name = rng.choice(sorted(DATED))
    times = moments(start, 30, 1_000_000 * rng.choice((1, 2, 40, 1000)))
    got = read_moments([DATED[name](m) for m in times]).stamp_ns
    assert got.tolist() == [ns(m) for m in times], name

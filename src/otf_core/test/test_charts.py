# SPDX-License-Identifier: Apache-2.0
"""Pictures: places of marks, round numbers on axes, classes of colours, whole files."""

import re
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from otf_core.reports.charts import (
    LEVELS,
    Bar,
    Panel,
    Scale,
    arrow_path,
    bars,
    dates,
    decades,
    heat_classes,
    heat_step,
    scale_around,
)
from otf_core.reports.rendering import TEMPLATES, typeset
from otf_core.reports.rendering import escaped as text
from otf_core.reports.scene import (
    ELEVATION,
    HEIGHT,
    WIDTH,
    Label,
    Strokes,
    box,
    magnification,
    scene,
    tracker_items,
)

STYLE = (TEMPLATES / 'page.css').read_text(encoding='utf-8')
MARKS = STYLE.partition('* { box-sizing')[0]


def numbers(path):
    return [float(v) for v in re.findall(r'-?[\d.]+', path)]


def test_marks_lie_where_the_data_say():
    panel = Panel(Scale(0.0, 10.0, 'x'), Scale(-1.0, 1.0, 'y'), 200, 120, 50, 10, 20, 30)
    assert panel.points([0, 10, 5], [-1, 1, 0]).tolist() == [[50, 90], [190, 20], [120, 55]]
    (drawn,) = re.findall(r'd="([^"]+)"', panel.line([0, 10], [-1, 1], 'after'))
    assert numbers(drawn) == [50, 90, 190, 20]
    columns = re.findall(r'd="([^"]+)"', panel.columns([0, 5, 10], [1.0, 0.0], 'after'))[0]
    assert numbers(columns)[:4] == [50, 55, 20, 120]


@pytest.mark.parametrize(
    ('low', 'high', 'marks'),
    [
        (0.0, 1.0, ['0.0', '0.5', '1.0']),
        (-27.86, 27.83, ['−20', '0', '20']),
        (-0.0012, 0.0031, ['−0.001', '0.000', '0.001', '0.002', '0.003']),
        (90.0, 130.0, ['90', '100', '110', '120', '130']),
    ],
)
def test_axes_are_marked_at_round_numbers(low, high, marks):
    assert [said for _, said in Scale(low, high, '').ticks] == marks


def test_logarithmic_axes_are_marked_even_over_less_than_a_decade():
    wide = decades([1e-3, 2e3], '')
    assert [v for v, _ in wide.ticks] == pytest.approx([1e-3, 1e-2, 0.1, 1, 10, 100, 1e3])
    assert len(decades([0.31, 0.55], '').ticks) >= 2
    assert wide.place([wide.low, wide.high]).tolist() == pytest.approx([0, 1])


def test_scales_hold_their_values_and_single_ones():
    assert scale_around([2.0, 2.0], '').place(2.0) == pytest.approx(0.5)
    scale = scale_around([0.0, 4.0, np.nan], '', zero=True)
    assert scale.low == 0.0 and scale.high > 4.0


@pytest.mark.parametrize(('days', 'shown', 'label'), [
    (0.2, ['09:00', '12:00'], '2026-11-20'),
    (6.0, ['11-22', '11-24', '11-26'], '2026, month-day'),
    (95.0, ['2026-12', '2027-01', '2027-02'], 'month'),
    (1461.0, ['2027', '2028', '2029', '2030', '2031'], 'year'),
    (9000.0, ['2030', '2035', '2040', '2045', '2050'], 'year'),
])  # fmt: skip
def test_dates_are_marked_where_years_months_or_days_begin(days, shown, label):
    first = datetime(2026, 11, 20, 8, tzinfo=timezone.utc)
    scale = dates(first, first + timedelta(days=days))
    assert [said for _, said in scale.ticks] == shown and scale.label == label
    assert all(scale.low <= value <= scale.high for value, _ in scale.ticks)
    moment = first + timedelta(days=scale.ticks[0][0])
    assert moment.strftime({'year': '%m-%d %H', 'month': '%d %H'}.get(label, '%M')) in (
        '01-01 00', '01 00', '00')  # fmt: skip


def test_classes_of_colours_reach_the_largest_value():
    values = np.array([0.0, 0.4, 3.0, 11.7])
    step = heat_step(values)
    assert step in (1.0, 2.0, 5.0)
    assert heat_classes(values, step).tolist() == [int(v // step) for v in values]
    assert step * LEVELS >= 11.7
    assert heat_step(np.zeros(3)) > 0


def test_every_class_of_colour_has_a_style():
    known = set(re.findall(r'\.([a-z][a-z0-9]*)', STYLE))
    assert {*(f'h{k}' for k in range(LEVELS)), *(f's{k}' for k in range(10))} <= known
    for mark in ('before', 'after', 'noise', 'ink', 'soft', 'x', 'y', 'z'):
        assert f'.line.{mark}' in STYLE and f'.area.{mark}' in STYLE and f'.dots.{mark}' in STYLE


def test_heads_of_arrows_lie_at_their_ends():
    places = numbers(arrow_path(np.array([[[0.0, 0.0], [100.0, 0.0]]])))
    assert places[:4] == [0, 0, 100, 0]
    left, tip, right = (places[k : k + 2] for k in (4, 6, 8))
    assert tip == [100, 0]
    assert left[1] == -right[1] != 0 and left[0] == right[0] < 100


def test_seen_from_the_front_x_runs_right_and_z_up():
    low, high = np.zeros(3), np.ones(3)
    picture = scene(
        [Strokes('ink', np.array([[low, [1, 0, 0]], [low, [0, 0, 1]]]))], low, high, ''
    )
    (drawn,) = re.findall(r'd="([^"]+)"', picture)
    ax, _, bx, _, *rest = numbers(drawn)
    assert bx > ax
    assert rest[3] < rest[1] and rest[2] == rest[0]
    assert sum(isinstance(item, Label) for item in box(low, high)) == 3


LABEL = re.compile(
    r'<text dx="([-\d.]+)" dy="([-\d.]+)" x="([\d.]+)" y="([\d.]+)" class="([^"]*)">([^<]+)<'
)


@pytest.mark.parametrize('place', [[0.1, -0.3, 0.0], [0.6, 0.0, -0.01], [-0.1, -0.1, 0.1]])
def test_no_label_of_a_scene_stands_over_another_or_leaves_the_picture(place):
    low, high = np.zeros(3), np.array([1.2, 0.8, 0.5])
    picture = scene([*box(low, high), *tracker_items(np.array(place), low, high)], low, high, '')
    found = []
    for dx, dy, x, y, css, said in LABEL.findall(picture):
        left, wide = float(x) + float(dx), 5.5 * len(said)
        left -= wide if 'end' in css else wide / 2 if 'middle' in css else 0
        found.append((left, float(y) + float(dy) - 9, left + wide, float(y) + float(dy)))
    assert len(found) == 4
    for k, a in enumerate(found):
        assert a[0] >= 0 and a[2] <= WIDTH and a[3] <= HEIGHT
        for b in found[:k]:
            assert min(a[2], b[2]) <= max(a[0], b[0]) or min(a[3], b[3]) <= max(a[1], b[1])


def test_labels_are_drawn_over_arrows_on_paper():
    low, high = np.zeros(3), np.ones(3)
    arrow = Strokes('heat arrow h1', np.array([[low, high]]), arrows=True)
    picture = scene([*box(low, high), arrow], low, high, '')
    assert picture.index('heat arrow') < picture.index('<text')
    assert picture.count('soft over"') == 3
    assert 'text.over { paint-order: stroke; stroke: var(--paper)' in MARKS


@pytest.mark.parametrize(('longest', 'reach', 'factor'), [(4.6e-5, 0.09, 1000), (1e-6, 0.2, 2e5)])
def test_errors_are_magnified_by_a_round_number_and_an_arrow_states_it(longest, reach, factor):
    shown = magnification(longest, reach)
    assert shown.factor == pytest.approx(factor)
    assert shown.factor * longest <= reach
    low, high = np.zeros(3), np.ones(3)
    picture = scene(box(low, high), low, high, '', shown=shown)
    assert f'{1e6 * shown.reference:g}\u00a0µm, errors ×' in picture
    ax, _, bx = numbers(re.search(r'<path class="line ink" d="([^"]+)"', picture)[1])[:3]
    long = shown.factor * shown.reference
    drawn = scene(
        [Strokes('soft', np.array([[low, [0, 0, long]]])), *box(low, high)], low, high, ''
    )
    _, top, _, foot = numbers(re.search(r'line soft" d="([^"]+)"', drawn)[1])
    assert (top - foot) / np.cos(ELEVATION) == pytest.approx(bx - ax, abs=0.3)


def test_words_of_bars_have_room_at_their_ends():
    said = ['38.2 ± 1.1 µm, limit 15', 'not known', '7.1 µm']
    rows = [Bar('EXX', ((38.2, 'bad'),), said[0], 15.0, (37.1, 39.3)), Bar('EYX', (), said[1]),
            Bar('EZX', ((7.1, 'after'),), said[2], 60.0)]  # fmt: skip
    places = re.findall(r'<text x="([\d.]+)" y="[\d.]+">', bars(rows, 'errors', width=300.0))
    assert len(places) == 3
    assert all(float(x) + 5.5 * len(w) <= 300.0 for x, w in zip(places, said, strict=True))


def test_text_is_set_as_metrologists_write_it():
    assert typeset(
        '-1.5 um +/- 0.2 um, 95 % of 3 urad/m'
    ) == '−1.5~µm~±~0.2~µm, 95~% of 3~µrad/m'.replace('~', '\u00a0')
    assert typeset('0.31 s (+/- 0.06)') == '0.31~s (±~0.06)'.replace('~', '\u00a0')
    assert typeset('15.91 → 0.69 um') == '15.91~→~0.69~µm'.replace('~', '\u00a0')
    assert typeset('elevation -0 deg, -0.0 mm, -0.04 mm') == (
        'elevation 0°, 0.0~mm, −0.04~mm'.replace('~', '\u00a0')
    )
    assert typeset('5 samples, 3 hours') == '5 samples, 3 hours'
    assert typeset('2026-11-22, --method otf, w-Y-b-X-Z-t, 1e-05, aluminum') == (
        '2026-11-22, --method otf, w-Y-b-X-Z-t, 1e-05, aluminum'
    )
    assert text('<b>"&') == '&lt;b&gt;&quot;&amp;'


def luminance(colour):
    """Relative luminance after WCAG 2.2."""
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize('dark', [False, True])
def test_words_and_marks_stand_out_from_the_paper(dark):
    begin = MARKS.index('@media')
    base = re.sub(r'@media[^{]*\{(?:[^{}]*\{[^{}]*\})+ *\}', '', MARKS)
    theme = ' '.join(re.findall(r'@media[^{]*\{((?:[^{}]*\{[^{}]*\})+) *\}', MARKS))
    assert begin and theme and '@media' not in base
    colours = {}
    for css in (base, theme) if dark else (base,):
        colours |= dict(re.findall(r'--([a-z]+\d?): (#\w{6})', css))
        colours |= dict(re.findall(r'\.([sh]\d) \{ --s: (#\w{6})', css))

    def contrast(name):
        pair = sorted((luminance(colours[name]), luminance(colours['paper'])))
        return (pair[1] + 0.05) / (pair[0] + 0.05)

    marks = ['before', 'after', 'noise', 'x', 'y', 'z', *(f's{k}' for k in range(10))]
    marks += [f'h{k}' for k in range(6)] if dark else ['h3', 'h4', 'h5']  # small errors are faint
    assert {
        n: contrast(n) for n in ('ink', 'soft', 'good', 'bad', 'open') if contrast(n) < 4.5
    } == {}
    assert {n: contrast(n) for n in marks if contrast(n) < 3} == {}

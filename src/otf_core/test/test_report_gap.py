# SPDX-License-Identifier: Apache-2.0
"""The report of a diagnosis: complete, self-contained, safe, readable without any cause."""

import functools
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import constant_tables, some_machine
from gap_cells import along, run_view, where_of
from html_cells import Page, unloading

from otf_core.diagnosis.answer import sentence_of
from otf_core.diagnosis.cause_parameters import CauseSize, Curve
from otf_core.diagnosis.place.where import describe_structure
from otf_core.diagnosis.result import AnyCause, Diagnosis, FigureData, Gap, NamedCause
from otf_core.diagnosis.weighing import Unnamed
from otf_core.model.expanded import quantity
from otf_core.model.sections import Circumstances
from otf_core.reports.diagnosis import (
    confidence_words,
    gap_pages,
)
from otf_core.reports.diagnosis import format_diagnosis as text_of
from otf_core.reports.rendering import typeset
from otf_core.solving.reversal import Backlash, Reversal

HIDDEN = (
    ('tracker_scale', 'a calibrated length: scale bar'),
    ('target_offset', 'runs with a second target offset'),
    ('table_tilt', 'a second tracker place'),
)
GAP = Gap(2.9, 1.1, 2.6, 0.5, 81.0, (76.0, 86.0))
STATED = Circumstances({'serial': '750123'}, {'operator': 'A. Miller'})
TABLES = constant_tables(replace(some_machine(), stated=STATED))
REVERSAL = Reversal('constant', {}, {}, backlash={'X': Backlash(4.4e-6, 0.3e-6)})
CONDITIONS = {'chain': 'w-b-X-Y-Z-t', 'samples': '39000', 'software': 'otf_core 0.1.0'}


def causes():
    return (
        NamedCause(
            'backlash', ('X', 'Z'), {'B_X': 4.2e-6, 'B_Z': -1.1e-6},
            {'B_X': 0.12e-6, 'B_Z': 0.2e-6}, {'B_X': 'm', 'B_Z': 'm'},
            2.6, 1.2, 54.0, 0.9997, (),
        ),
        NamedCause(
            'cyclic_error', ('Y',), {'period': 0.01, 'S_Y': 1e-6}, {'S_Y': 1e-7},
            {'period': 'm', 'S_Y': 'm'}, 1.2, 0.9, 25.0, 0.93, ('vibration',),
        ),
        NamedCause(
            'table_tilt', ('X',), {'tilt_Y_by_X': 4e-6}, {'tilt_Y_by_X': 2e-7},
            {'tilt_Y_by_X': 'rad/m'}, 0.9, 0.5, 44.0, 0.6, (),
        ),
    )  # fmt: skip


def document(found):
    """The diagnosis as it is in its file."""
    return json.loads(json.dumps(found.document.to_dict()))


def report_html(found):
    return gap_pages(document(found))['report.html']


def format_diagnosis(found):
    return text_of(document(found))


@functools.cache
def located():
    view = run_view(
        lambda v: along(2, 3e-6 * (v.time >= 60)), laps=1, after=lambda v: 0.0 * v.q, name='run-7'
    )
    return view, where_of([view]), describe_structure([view], 'residual_after')


def diagnosis(view, verdict='explained', found=(), **further):
    gap = Gap(2.9, 1.1, 2.6, 0.5 if found else 2.6, 81.0, (76.0, 86.0))
    fields = {
        'runs': (view.name,),
        'verdict': verdict,
        'sentence': 'The gap of 2.60 um is what it is.',
        'gap': gap,
        'causes': tuple(found),
        'unexplained_um': 0.5,
        'unexplained_where': located()[2],
        'not_visible': HIDDEN,
        'where': located()[1],
        'considered': (),
        'smallest_found_um': {},
        'contradictions': (),
        'table_change_um': 0.0,
        'applied': (),
        'calibration': SimpleNamespace(
            plain=SimpleNamespace(tables=TABLES, runs=(), reversal=REVERSAL, run_id='1')
        ),
        'origin': (),
        'shown': FigureData((view,), CONDITIONS),
        'any_cause': AnyCause(1e-6),
    }
    return Diagnosis(**{**fields, **further})


@pytest.fixture(scope='module')
def view():
    return located()[0]


@pytest.fixture(scope='module')
def page(view):
    return report_html(diagnosis(view, found=causes()))


def test_page_is_well_formed(page):
    reader = Page(page)
    assert reader.faults == []
    assert reader.open == []


def test_paper_names_the_diagnosis_in_its_head(view):
    page = report_html(diagnosis(view, found=causes()))
    assert re.search(r'@top-left \{ content: "[^"]*diagnosis of run', page)


def test_page_needs_nothing_else(page):
    assert unloading(page) == []
    assert Page(page).scripts == 0


def test_references_within_the_page_have_a_target(page):
    wanted = set(re.findall(r'href="#([^"]+)"', page)) | set(re.findall(r'url\(#([^)]+)\)', page))
    names = re.findall(r'\bid="([^"]+)"', page)
    assert wanted <= set(names)
    assert len(names) == len(set(names))


def test_page_is_small(page):
    assert len(page.encode()) < 1.5e6


def test_causes_are_ranked_with_axes_units_and_uncertainty(page):
    text = Page(page).text
    places = [text.index(name, text.index('Causes')) for name in ('backlash', 'cyclic error')]
    assert places == sorted(places)
    for part in (
        'X, Z', '4.20 ± 0.24 µm', '−1.10 ± 0.40 µm', '10 mm', '1.00 ± 0.20 µm',
        '4.00 ± 0.40 µrad/m', 'k = 2', 'indistinguishable from vibration', 'practically certain',
        'likely (93', 'more likely than not (60',
    ):  # fmt: skip
        assert part in text, part


def test_gap_is_shown_before_and_after_with_its_interval(page):
    text = Page(page).text
    for part in ('2.90 µm', '1.10 µm', '2.60 µm', '0.50 µm', '81 %', '76 % to 86 %'):
        assert part in text, part


def test_every_effect_that_is_not_visible_is_listed_with_what_shows_it(page):
    text = Page(page).text
    start = text.index('so they are neither')
    part = text[start : text.index('rms (µm)', start)]
    for effect, needs in HIDDEN:
        assert effect.replace('_', ' ') in part
        assert needs in part


def test_conditions_and_runs_are_stated(page):
    text = Page(page).text
    shown = {k: v for k, v in CONDITIONS.items() if k != 'samples'}
    for part in ('run-7', *shown, *shown.values(), 'A. Miller', '750123'):
        assert part in text, part
    assert re.search(r'Not stated:.*air temperature', text)


def test_all_pictures_are_there(page):
    drawn = re.findall(r'<svg[^>]*aria-label="([^"]+)"', page)
    assert len(drawn) == page.count('<svg') == len(set(drawn))
    for part in (
        'sizes of',
        'against time',
        'over X and Y',
        'line and feed',
        'azimuth',
        'frequency',
    ):
        assert any(part in label for label in drawn), part


def test_axis_labels_keep_their_digits(page):
    assert 'feed 15000 mm/min' in Page(page).text


def test_strange_names_are_escaped(view):
    evil = '<script>alert("1")</script>&\'x'
    cause = NamedCause(evil, (evil,), {evil: 1e-6}, {}, {evil: evil}, 1.0, 0.5, 50.0, 0.9, (evil,))
    asked = FigureData(
        views=(run_view(laps=1, name=evil), run_view(laps=1, name='b', seed=2)),
        conditions={evil: evil},
    )
    found = diagnosis(
        view, found=(cause,), runs=(evil,), sentence=evil, unexplained_where=evil,
        not_visible=((evil, evil),), shown=asked,
    )  # fmt: skip
    page = report_html(found)
    reader = Page(page)
    assert '<script' not in page
    assert reader.faults == []
    assert reader.text.count('alert("1")') >= 8


@pytest.mark.parametrize(
    ('verdict', 'words'),
    [
        ('none', 'the run shows nothing beyond its simulation'),
        ('unknown', 'no effect of the catalogue explains the gap'),
    ],
)
def test_verdicts_without_causes_are_readable(view, verdict, words):
    page = report_html(diagnosis(view, verdict, unexplained_where='since 60 s, step'))
    reader = Page(page)
    assert reader.faults == []
    assert words in reader.text
    assert 'Gap after' not in reader.text
    part = reader.text[reader.text.rindex('Causes') :].split('What stays unexplained')[0]
    assert ('since 60 s, step' in part) == (verdict == 'unknown')


def test_long_lists_of_parameters_are_cut(view):
    names = [f'S_{k}' for k in range(40)]
    cause = NamedCause(
        'direction_dependent_tables', ('X',), dict.fromkeys(names, 1e-6),
        dict.fromkeys(names, 1e-7), dict.fromkeys(names, 'm'), 2.0, 1.0, 50.0, 0.99, (),
    )  # fmt: skip
    assert '32 more significant ones in gap.json' in report_html(diagnosis(view, found=(cause,)))


def test_next_measurements_tell_rivals_apart_first(view):
    lines = list(diagnosis(view, 'partly_explained', found=causes()).document.measure_next)
    assert 'to distinguish cyclic error from vibration' in lines[0]
    assert any('second feed' in line for line in lines)
    assert any(line.startswith('A calibrated length') for line in lines)


def test_wishes_that_begin_alike_share_a_line(view):
    hidden = (
        ('table_tilt', 'a second tracker place, or a level'),
        ('other', 'a second tracker place'),
    )
    lines = list(diagnosis(view, not_visible=hidden).document.measure_next)
    assert lines == ['A second tracker place (or a level): to see table tilt and other.']


@pytest.mark.parametrize(
    ('value', 'u', 'unit', 'text'),
    [
        (0.01, None, 'm', '10 mm'),
        (2.5e-6, 4e-7, 'm', '2.50 ± 0.80 µm'),
        (-1.2e-5, 2e-6, 'rad', '−12.0 ± 4.0 µrad'),
        (1.1e-5, 1e-6, 'm/m', '11.0 ± 2.0 µm/m'),
        (12.5, 0.5, 'Hz', '12.5 ± 1.0 Hz'),
        (4.0, np.inf, 's', '4 s'),
        (3.0, None, '', '3'),
        (1.5e-4, None, 's', '0.15 ms'),
    ],
)
def test_quantities_are_readable(value, u, unit, text):
    assert typeset(quantity(value, u, unit)).replace('\u00a0', ' ') == text


@pytest.mark.parametrize('confidence', [0.0, 0.3, 0.9, 0.97, 1.0])
def test_confidence_has_words_and_a_number(confidence):
    assert re.fullmatch(r'[a-z ]+ \(>?\s?[\d.]+\s%\)', confidence_words(confidence))


# ---------------------------------------------------------------- free functions


PLAY = Curve(
    'B_X', 'X', 'time', 's', (0.0, 100.0, 200.0), (2e-6, 3e-6, 6e-6), (1e-7, 1e-7, 2e-7), 'm', {}
)


def test_free_form_shows_how_it_departs_and_its_function(view):
    first = replace(
        causes()[0], form='free', departs='the backlash changes during the run', curves=(PLAY,)
    )
    page = report_html(diagnosis(view, found=(first, *causes()[1:])))
    reader = Page(page)
    assert reader.faults == [] and unloading(page) == []
    assert 'Departs from the formula: the backlash changes during the run' in reader.text
    assert 'B_X against time' in page and 'Functions found' in reader.text
    assert 'Functions found' not in Page(report_html(diagnosis(view, found=causes()))).text


def test_cause_without_a_name_is_described_with_its_sizes(view):
    unnamed = Unnamed(
        ('time', 'x'), 'direction', 'depends on time and the position of X', 2.6, 0.4, 84.6,
        (80.0, 90.0), (replace(PLAY, held={'x': 0.3}),),
    )  # fmt: skip
    answer = diagnosis(view, 'unknown', unnamed=unnamed)
    text = Page(report_html(answer)).text
    for part in ('It depends on time and the position of X', 'from 2.60 µm to 0.40 µm', '80 %'):
        assert part in text, part


# ---------------------------------------------------------------- the first screen


def size(of, value, u):
    return CauseSize(of, value, u, 'm')


def plain(page):
    """Text of a page with plain spaces."""
    return Page(page).text.replace('\u00a0', ' ')


def first_screen(page):
    """Text of what stands before the list of sections."""
    return plain(page.split('<nav')[0])


def test_headline_has_the_size_with_axis_unit_and_uncertainty(view):
    cause = replace(causes()[0], sizes=(size('of X', 5.02e-6, 0.095e-6),))
    assert 'backlash of X, 5.02 +/- 0.19 um' in sentence_of('explained', GAP, [cause], None)
    text = first_screen(report_html(diagnosis(view, found=(cause,))))
    assert 'Backlash of X 5.02 ± 0.19 µm' in ' '.join(text.split())


def test_gap_is_one_number_in_text_json_and_page(view):
    answer = diagnosis(view, found=causes())
    data, text = answer.document.to_dict(), format_diagnosis(answer)
    first = first_screen(report_html(answer))
    before, after = data['gap']['before_um'], data['gap']['after_um']
    assert f'gap {before:.2f} um -> {after:.2f} um' in text
    assert f'{before:.2f} → {after:.2f} µm' in first
    stated = set(re.findall(r'gap (?:is|of) ([\d.]+)', f'{text} {first}'))
    assert stated == {f'{before:.2f}'}
    assert 'noise leaves' not in text  # a second simulated residual


def test_first_screen_shows_where_before_and_after_at_one_scale(page):
    part = page[: page.index('<nav')]
    drawn = re.findall(r'aria-label="(where it lies[^"]*)"', part)
    assert len(drawn) == 2 and 'without the causes' in drawn[0] and 'with the causes' in drawn[1]
    assert 'Where the gap lies' in part and 'The gap lies after ' in Page(part).text
    tops = [re.findall(r'class="end">([\d.]+)<', svg)[-1] for svg in part.split('<svg')[1:3]]
    assert tops[0] == tops[1]


@pytest.mark.parametrize(
    ('gap', 'view_name', 'label'),
    [
        (lambda v: along(0, 3e-6 * np.sign(v.direction[:, 0])), 'path', 'where it lies: lines'),
        (lambda v: along(1, 4e-6 * (v.q[:, 0] > 0.5)), 'volume', 'residual over X and'),
    ],
)
def test_picture_is_of_the_view_that_separates_most(gap, view_name, label):
    own = run_view(gap, laps=2, after=lambda v: 0.0 * v.q)
    where, shown = where_of([own]), FigureData((own,), CONDITIONS)
    assert where.view == view_name
    page = report_html(diagnosis(own, found=causes(), where=where, shown=shown))
    assert len(re.findall(f'aria-label="{label}', page.split('<nav')[0])) == 2


def test_only_significant_coefficients_are_listed(view):
    names = ('B_X', 'B_Y', 'B_Z')
    weak = replace(
        causes()[0], parameters={'B_X': 4.2e-6, 'B_Y': 1e-7, 'B_Z': -1e-7},
        u=dict.fromkeys(names, 1e-7), units=dict.fromkeys(names, 'm'),
    )  # fmt: skip
    answer = diagnosis(view, found=(weak,))
    for text in (format_diagnosis(answer), plain(report_html(answer))):
        assert 'B_X' in text and '2 further are not significant' in text
        assert 'B_Y' not in text and 'B_Z' not in text
    assert set(answer.document.to_dict()['causes'][0]['parameters']) == set(names)


@pytest.mark.parametrize('verdict', ['none', 'unknown'])
def test_without_a_cause_the_first_screen_says_what_would_have_been_seen(view, verdict):
    seen = {'backlash': 0.13, 'target_incidence': 0.7}
    answer = diagnosis(view, verdict, smallest_found_um=seen)
    for text in (format_diagnosis(answer), first_screen(report_html(answer))):
        assert 'Considered: 5 effects. 2 of them would have been detected' in text
        assert re.search(r'0\.13 [µu]m \(backlash\) to 0\.70 [µu]m \(target incidence\)', text)
        assert 'whatever their size: tracker scale, target offset and table tilt' in text
    assert 'Considered' not in format_diagnosis(diagnosis(view, found=causes()))


def test_reversal_tables_state_their_own_value_and_why_it_differs(view):
    answer = diagnosis(view, found=causes())
    for text in (format_diagnosis(answer), plain(report_html(answer))):
        assert 'reversal tables of the calibration contain backlash as well (X 4.40' in text
        assert 'every motion of every axis may reverse' in text

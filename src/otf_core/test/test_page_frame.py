# SPDX-License-Identifier: Apache-2.0
"""The frame of all pages: badges, tables on a phone, words, print."""

import re

from html_cells import Page, unloading

from otf_core.reports.drawing.style import STYLE, running_head
from otf_core.reports.page import Heading, Picture, Section, State, Table, page_html

SENTENCE = 'Errors within 5.0 um.'


def page_of(*sections, **more):
    return page_html(Heading('Title', SENTENCE, **more), sections)


def test_each_question_has_its_own_badge_in_the_colour_of_its_answer():
    badges = State('measurement good', 'good'), State('1 of 4 limits broken', 'bad')
    source = page_of(Section('a', ''), badges=badges)
    assert re.findall(r'<span class="badge (\w+)">([^<]+)</span>', source) == [
        ('good', 'measurement good'), ('bad', '1 of 4 limits broken'),
    ]  # fmt: skip
    assert Page(source).faults == []
    assert unloading(source) == []


def test_a_state_in_a_table_has_the_colour_of_its_mood():
    table = Table(('what', 'state'), (('EXX', State('fail', 'bad')),))
    assert '<td><b class="bad">fail</b></td>' in page_of(Section('a', 'A', tables=(table,)))


def test_a_stacked_table_says_its_heads_in_every_cell():
    rows = (('run1', '12.3'),)
    stacked = page_of(Section('a', 'A', tables=(Table(('run', 'mean'), rows, stacked=True),)))
    flat = page_of(Section('a', 'A', tables=(Table(('run', 'mean'), rows),)))
    assert '<td data-head="run">run1</td><td data-head="mean">12.3</td>' in stacked
    assert 'class="cards"' in stacked
    assert 'data-head=' not in flat.replace(STYLE, '')


def test_facts_stand_beside_each_other_and_tables_with_heads_do_not():
    bare, headed = Table(('', ''), (('a', 'b'),)), Table(('x', 'y'), (('a', 'b'),))
    assert 'class="sheet"' not in page_of(Section('a', 'A', tables=(bare, headed)))
    source = page_of(Section('a', 'A', tables=(bare, bare, headed)))
    sheet, rest = re.search(r'<div class="sheet">(.*?</table></div>)</div>(.*)', source).groups()
    assert sheet.count('<table') == 2
    assert '<th>x</th>' in rest


def test_many_words_stand_in_two_columns_and_few_do_not():
    short = page_of(Section('a', 'A', ('One.', 'Two.')))
    long = page_of(Section('a', 'A', ('One. ' * 50, 'Two. ' * 50)))
    assert 'class="words"' in short
    assert 'class="words many"' in long


def test_every_printed_page_has_head_and_number():
    source = page_of(Section('a', ''), running='cell-600, run 1a2b, 2026-11-25')
    rule = re.search(r'@page \{.*?\} \}', source)[0]
    assert '@top-left { content: "cell-600, run 1a2b, 2026-11-25"' in rule
    assert 'counter(page) " / " counter(pages)' in rule
    assert 'content: "Title"' in page_of(Section('a', ''))


def test_a_name_cannot_break_out_of_the_running_head():
    rule = running_head('a"; } </style><script>\n\\')
    assert '</' not in rule
    assert re.search(r'content: "([^"]*)";', rule)[1].count('\\') == 8


def test_paper_cuts_no_row_off_its_table():
    paper = STYLE[STYLE.index('@media print') :]
    for rule in (
        'tr, li { break-inside: avoid; }',
        'tbody tr:nth-last-child(-n+2) { break-before: avoid; }',
        'h2, h3, caption { break-after: avoid; }',
    ):
        assert rule in paper


def test_paper_may_break_long_figures_alone_and_leaves_hints_to_screens():
    def of(count):
        picture = Picture(('<svg></svg>',) * count, 'Captions.', hint='Drag it.')
        return page_of(Section('a', 'A', draw=lambda: (picture,)))

    assert '<figure class="long">' in of(18)
    assert '<figure>' in of(2)
    assert 'Captions. <span class="screen">Drag it.</span>' in of(2)
    paper = STYLE[STYLE.index('@media print') :]
    assert '.long { break-inside: auto; }' in paper
    assert '.pictures > div { break-inside: avoid; }' in paper

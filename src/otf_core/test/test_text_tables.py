# SPDX-License-Identifier: Apache-2.0
"""One grammar of text tables: every kind is read as the others, or refused with its reason."""

import re
from pathlib import Path

import numpy as np
import pytest
from table_texts import COUNT, HEAD, KINDS, LEFT_OUT, READ, REFUSED, XYZ, both, table

from otf_core.cli.parser import Parser
from otf_core.errors import InputError
from otf_core.inputs.path_file import read_points
from otf_core.inputs.recordings import ReadingOptions, read_recording
from otf_core.inputs.text_points import TextReading
from otf_core.model.provenance import origins, provenance

DOCS = Path(__file__).resolve().parents[3] / 'docs' / 'commands.md'


def reading(folder, text, **options):
    file = folder / 'run.csv'
    file.write_text(text, encoding='utf-8')
    return TextReading(file, **options)


@pytest.mark.parametrize('name', READ)
def test_every_form_holds_the_same_points(tmp_path, name):
    text, options = READ[name]
    got = reading(tmp_path, text, **options)
    raw = got.received()
    np.testing.assert_allclose(1e3 * raw.xyz, XYZ, atol=1e-4 * (1 + ('in' in text)))
    np.testing.assert_allclose(raw.stamp_ns - raw.stamp_ns[0], 4e7 * np.arange(COUNT), atol=2)
    assert not got.left_out


@pytest.mark.parametrize('name', LEFT_OUT)
def test_a_line_that_is_no_sample_is_left_out_and_counted(tmp_path, name):
    row, text, why = LEFT_OUT[name]
    got = reading(tmp_path, text)
    np.testing.assert_allclose(1e3 * got.received().xyz, np.delete(XYZ, row, axis=0), atol=1e-9)
    if why:
        assert got.remarks[0].endswith(f'lines that are not samples: 1 line: {why}')
        assert [(o.lines, o.reason) for o in got.left_out] == [(1, why.rpartition(' (')[0])]
    else:
        assert not got.remarks


@pytest.mark.parametrize('name', REFUSED)
def test_what_cannot_be_read_is_refused_with_its_reason(tmp_path, name):
    text, options, words = REFUSED[name]
    with pytest.raises(InputError) as caught:
        reading(tmp_path, text, **options)
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize(('choice', 'shift'), [(0, 0.5), (1, 0.0)])
@pytest.mark.parametrize('head', ['time_s;X;Y;Z;X;Y;Z', 'X;Y;Z;q;x.2;y.2;z.2'])
def test_a_choice_of_columns_works_as_it_is_printed(tmp_path, head, choice, shift):
    rows = both(head)
    options = {}
    if not head.startswith('time'):
        cells = [line.split(';') for line in rows.splitlines()[1:]]
        rows = table(head, [[*c[1:4], c[0], *c[4:]] for c in cells])
        options = {'rate': 25.0}
    with pytest.raises(InputError) as caught:
        reading(tmp_path, rows, **options)
    columns = re.findall(r'--columns (\S+)', str(caught.value))[choice]
    parser = Parser()
    parser.add_argument('--columns')
    assert parser.parse_args(['--columns', columns]).columns == columns
    got = reading(tmp_path, rows, columns=columns, **options)
    np.testing.assert_allclose(
        1e3 * got.received().xyz, np.round(XYZ, 3 + choice) + shift, atol=6e-4
    )


def test_what_is_left_out_goes_with_the_recording(tmp_path):
    (tmp_path / 'run.csv').write_text(LEFT_OUT['#DIV/0!'][1])
    (tmp_path / 'path.csv').write_text('x,y,z\n0,0,0\n0.1,0,0\n0.1,0.1,0\n')
    (tmp_path / 'm.yaml').write_text(MACHINE)
    given = ReadingOptions(path=tmp_path / 'path.csv')
    recording = read_recording([tmp_path / 'run.csv'], tmp_path / 'm.yaml', given)
    (told,) = provenance('calibrate', runs=origins([recording]))['runs']
    assert told['left_out'] == [{'reason': "x_mm is '#DIV/0!'", 'lines': 1, 'first_line': 9}]


@pytest.mark.parametrize('digits', [3, 7])
def test_positions_without_noise_are_said_to_be_commanded(tmp_path, digits):
    at = np.linspace([100.0, -200.0, 50.0], [400.0, 100.0, 51.0], 400)
    noisy = at + np.random.default_rng(8).normal(0.0, 2e-3, at.shape)
    for values, said in ((at, True), (noisy, False)):
        rows = [[f'{0.01 * k:.3f}', *(f'{v:.{digits}f}' for v in p)] for k, p in enumerate(values)]
        remarks = reading(tmp_path, table(';'.join(HEAD), rows)).remarks
        assert any('no noise beyond their rounding' in remark for remark in remarks) == said


def test_of_points_and_paths_the_nominal_ones_are_taken(tmp_path):
    (tmp_path / 'points.csv').write_text(
        both('t;Soll X;Soll Y;Soll Z;Ist X;Ist Y;Ist Z').replace('t;', 'q;', 1)
    )
    points, said = read_points(tmp_path / 'points.csv')
    assert points[0, 0] == float(f'{XYZ[0, 0]:.3f}') + 0.5
    assert 'columns 2, 3, 4' in said


MACHINE = 'name: m\nchain: w-b-X-Y-Z-t\naxes:\n' + ''.join(
    f'  {a}: {{min: {low}, max: {high}, table_pitch: 0.1}}\n'
    for a, low, high in (('X', 0.0, 0.3), ('Y', 0.0, 0.2), ('Z', -0.2, 0.0))
) + 'target_offset: [0, 0, 0]\ntracker: {u_range: 1e-6, u_angle: 1e-6}\n'  # fmt: skip


def test_the_grammar_in_the_docs_is_that_of_these_texts():
    known = {*READ, *LEFT_OUT, *REFUSED}
    shown = [name for _, _, names in KINDS for name in names]
    assert sorted(shown) == sorted(known)
    lines = ['| in a table | is |', '|---|---|', *(f'| {k} | {done} |' for k, done, _ in KINDS)]
    assert '\n'.join(lines) in DOCS.read_text(encoding='utf-8')

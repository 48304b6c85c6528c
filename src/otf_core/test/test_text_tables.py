# SPDX-License-Identifier: Apache-2.0
"""One grammar of text tables: every kind is read as the others, or refused with its reason."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from cli_cells import run
from table_texts import COUNT, HEAD, KINDS, LEFT_OUT, READ, REFUSED, ROWS, XYZ, both, table

from otf_core.cli.parser import Parser
from otf_core.errors import ConfigError, InputError
from otf_core.files.message_text import shortened, without_middle
from otf_core.inputs.path_file import read_points
from otf_core.inputs.recordings import ReadingOptions, read_recording
from otf_core.inputs.text_points import TextReading
from otf_core.model.provenance import origins, provenance
from otf_core.tracking import no_match

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


@pytest.mark.parametrize('name', [name for name in LEFT_OUT if name != 'commented out'])
def test_of_points_none_is_left_out(tmp_path, name):
    _, text, why = LEFT_OUT[name]
    if why.startswith('time_s'):
        text = (
            text.replace('time_s', 'z_nom', 1).replace('z_mm', 'q', 1).replace('z_nom', 'z_mm', 1)
        )
    (tmp_path / 'points.csv').write_text(text)
    line = why.rpartition('line ')[2].rstrip(')')
    with pytest.raises(ConfigError, match=rf'points\.csv: line {line}: expected numbers'):
        read_points(tmp_path / 'points.csv')


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


def test_columns_that_begin_with_a_dash_are_taken_on_the_command_line(tmp_path, capsys):
    file = tmp_path / 'run.csv'
    file.write_text(table('', [['-5', 'a', *row] for row in ROWS]))
    assert run(
        'noise', file, '--out', tmp_path / 'o', '--columns', '-,-,time_s,x_mm,y_mm,z_mm'
    ) in (0, 3)
    assert 'x, y, z from x_mm, y_mm, z_mm in mm' in capsys.readouterr().err


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
    assert 'the nominal point is columns 2, 3, 4' in said


def test_a_clean_table_is_read_as_one_with_a_quoted_field_bit_for_bit(tmp_path):
    fast = reading(tmp_path, table(';'.join(HEAD), ROWS)).received()
    slow = [list(row) for row in ROWS]
    slow[7][1] = f'"{slow[7][1]}"'
    for text in (table(';'.join(HEAD), slow), table(';'.join(HEAD), ROWS).replace('\n', ' \n')):
        raw = reading(tmp_path, text).received()
        np.testing.assert_array_equal(raw.xyz, fast.xyz)
        np.testing.assert_array_equal(raw.stamp_ns, fast.stamp_ns)


LATTICE = 'x{p},y{p},z{p},dx{e},dy{e},dz{e}\n' + ''.join(
    f'{x},{y},{z},{0.1 * x},{0.1 * y},{0.1 * z}\n'
    for x in (0, 0.3)
    for y in (0, 0.2)
    for z in (-0.2, 0)
)
MACHINE = 'name: m\nchain: w-b-X-Y-Z-t\naxes:\n' + ''.join(
    f'  {a}: {{min: {low}, max: {high}, table_pitch: 0.1}}\n'
    for a, low, high in (('X', 0.0, 0.3), ('Y', 0.0, 0.2), ('Z', -0.2, 0.0))
) + 'target_offset: [0, 0, 0]\ntracker: {u_range: 1e-6, u_angle: 1e-6}\n'  # fmt: skip


@pytest.mark.parametrize(
    ('position', 'error', 'words'),
    [
        ('', '', 'write dx_mm,dy_mm,dz_mm into the header'),
        ('_mm', '_um', ''),
        ('_m', '_mm', ''),
        ('', '_ft', 'dx_ft'),
    ],
)
def test_a_lattice_in_other_units_is_read_or_refused_with_the_cure(
    tmp_path, capsys, position, error, words
):
    scale = 1000 if position == '_mm' else 1
    text = LATTICE.format(p=position, e=error)
    if scale > 1:
        text = re.sub(r'^(-?[\d.]+),(-?[\d.]+),(-?[\d.]+)', lambda m: ','.join(
            f'{scale * float(v):g}' for v in m.groups()), text, flags=re.MULTILINE)  # fmt: skip
    (tmp_path / 'l.csv').write_text(text)
    (tmp_path / 'm.yaml').write_text(MACHINE)
    code = run(
        'import', tmp_path / 'l.csv', '--machine', tmp_path / 'm.yaml', '--out', tmp_path / 'o'
    )
    shown = capsys.readouterr().err
    assert (code, words in shown) == ((2, True) if words else (0, True)), shown
    if not words:
        content = json.loads((tmp_path / 'o' / 'error_tables.json').read_text())
        largest = max(map(abs, content['motions']['EXX']['value']))
        assert largest == pytest.approx(0.03 * {'_um': 1e-6, '_mm': 1e-3}[error], rel=0.7)


def test_the_grammar_in_the_docs_is_that_of_these_texts():
    known = {*READ, *LEFT_OUT, *REFUSED}
    shown = [name for _, _, names in KINDS for name in names]
    assert sorted(shown) == sorted(known)
    lines = ['| in a table | is |', '|---|---|', *(f'| {k} | {done} |' for k, done, _ in KINDS)]
    assert '\n'.join(lines) in DOCS.read_text(encoding='utf-8')


@pytest.mark.parametrize(
    ('ratio', 'words'),
    [
        (1000.0, 'the points seem to be in mm'),
        (0.001, 'the path seems to be in mm'),
        (39.5, 'the points seem to be in inches:'),
        (1 / 39.2, 'the path seems to be in inches:'),
        (1 / 25.3, 'the points seem to be in inches, not mm:'),
        (7.0, ''),
    ],
)
def test_a_track_in_another_unit_than_its_path_has_it_named(ratio, words):
    said = no_match.unit_by_size(ratio)
    assert words in said and bool(words) == bool(said)
    turned = np.eye(3)[[1, 2, 0]] * 0.6 + 0.8 * np.eye(3)[[2, 0, 1]] * [[1, -1, 1]]
    cube = np.array([[x, y, z] for x in (0, 3) for y in (0, 2) for z in (0, 1.0)])
    assert no_match.extent(ratio * cube) == pytest.approx(ratio * 14**0.5)
    q, _ = np.linalg.qr(turned)
    assert no_match.extent(cube @ q) == pytest.approx(14**0.5)


@pytest.mark.parametrize(
    ('text', 'length', 'short'),
    [
        ('a, 123.456, b', 9, 'a ...'),
        ('a123.456789', 9, 'a ...'),
        ('abc def ghi', 9, 'abc def ...'),
        ('a long word; another', 13, 'a long word ...'),
        ('abcdefghijkl', 6, 'abcdef ...'),
        ('x 12345', 5, 'x ...'),
        ('x 12345', 7, 'x 12345'),
    ],
)
def test_text_of_a_message_is_not_cut_inside_a_number(text, length, short):
    assert shortened(text, length) == short


def test_long_message_keeps_its_beginning_and_its_end_at_whole_words():
    assert without_middle('alpha beta gamma delta epsilon', 20) == 'alpha beta ... epsilon'
    assert without_middle('alpha beta', 20) == 'alpha beta'

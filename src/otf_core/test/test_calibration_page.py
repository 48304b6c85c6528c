# SPDX-License-Identifier: Apache-2.0
"""The report of a calibration: complete, self-contained, and its numbers those of the files."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import constant_tables, some_machine
from html_cells import Page, number, unloading

import otf_core
from otf_core.calibration.calibrate import calibrate, calibrate_recordings
from otf_core.calibration.views import deviations, diagonals, drift
from otf_core.model.machine import AXES
from otf_core.model.motions import MOTIONS
from otf_core.model.sections import Circumstances, DeclaredUncertainty, Limits
from otf_core.pieces.runs import Recording
from otf_core.reports.calibration import write_calibration
from otf_core.reports.calibration_page import calibration_page
from otf_core.reports.pages import pages_of
from otf_core.solving.reversal import Reversal, ReversalTable

STATED = {
    'instrument': {'model': 'AT <960>', 'serial': '750123', 'firmware': '7.1', 'mode': 'ADM',
                   'calibrated': '2026-03-01', 'mpe': '15 um + 6 um/m', 'target': 'RRR 42'},
    'conditions': {'operator': 'A. Miller', 'air_temperature_celsius': 20.4,
                   'air_pressure_pa': 101200, 'relative_humidity_percent': 45,
                   'material_temperature_celsius': 20.9, 'warm_up_s': 3600},
}  # fmt: skip
LIMITS = {'volumetric_error': 1e-3, 'uncertainty': 1e-4, 'EXX': 2e-6, 'C0Y': 1e-3}
DECLARED = {'tracker_scale': 1e-6, 'machine_temperature': 0.5, 'expansion': 1.2e-5}


@pytest.fixture(scope='module')
def result(cell):
    """The small cell with everything that a report can state."""
    machine = replace(
        cell.machine,
        uncertainty=DeclaredUncertainty(DECLARED),
        limits=Limits(LIMITS),
        stated=Circumstances(**STATED),
    )
    return calibrate(cell.recording.measured(cell.truth), cell.path, machine)


@pytest.fixture(scope='module')
def folder(result, tmp_path_factory):
    place = tmp_path_factory.mktemp('calibration')
    write_calibration(result, place)
    return place


@pytest.fixture(scope='module')
def source(folder):
    return (folder / 'report.html').read_text(encoding='utf-8')


@pytest.fixture(scope='module')
def page(source):
    return Page(source)


@pytest.fixture(scope='module')
def tables(folder):
    return json.loads((folder / 'error_tables.json').read_text())


def test_page_is_well_formed_and_needs_nothing_else(page, source):
    assert page.faults == []
    assert page.open == []
    assert unloading(source) == []
    assert len(source.encode()) < 1.5e6


def test_what_is_stated_is_escaped(source):
    assert 'AT &lt;960&gt;' in source
    assert 'AT <960>' not in source


def test_every_picture_is_named_for_those_who_cannot_see_it(source):
    drawn = re.findall(r'<svg[^>]*aria-label="([^"]+)"', source)
    assert len(drawn) == source.count('<svg')
    for motion in MOTIONS:
        assert [label for label in drawn if label.startswith(motion)]
    assert 'NaN' not in source
    assert 'nan' not in re.sub(r'[a-z]nan|nan[a-z]', '', source)


TEN_QUESTIONS = {
    'Is the machine within its limits?': r'machine: 1 of 4 limits broken',
    'How large is the volumetric error now, and how large at most after compensation?':
        r'Volumetric error as found: mean [\d.]+ µm, largest [\d.]+ ± [\d.]+ µm; '
        r'expected after compensation: mean [\d.]+ µm, largest [\d.]+ µm \(U, k = 2; ',
    'Where is it worst, and which motion is to blame?':
        r'longest error vector of \d+ points of .*, [\d.]+ µm, lies at X [\d.−]+, Y .* '
        r'It is mainly due to E.* Largest displacement: E[XYZ]{2}, [a-z]+, [\d.−]+ ± [\d.]+ µm '
        r'at [XYZ] [\d.−]+ mm',
    'What is not known?': r'Not known: ',
    'Is Y square to X, which way does it lean, and how sure is that?':
        r'C0Y: angle between \+X and \+Y is 90° [+−-] [\d.]+ µrad.* U \(µrad\) '
        r'u in the files, k = 1 \(µrad\) Holds C0Y',
    'Is a positive error towards larger or smaller positions?':
        r'an error is actual minus nominal position .* A correction has the opposite sign',
    'Does the machine go another way forward than backward?': r'Reversal model: \w+',
    'What is the largest contribution to the uncertainty?':
        r'The largest contribution in the volume is [a-z ,]+: \d+ % of the variance',
    'Did machine or tracker drift during the run, or was the tracker moved?':
        r'(No drift beyond U|Larger than U: along [XYZ]).* (No movement: no step|Moved: tracker)',
    'With what, when and under which conditions was it measured, and how is it repeated?':
        r'serial number 750123 .* Clock of .* s\. .* How to repeat it: \./otf calibrate',
}  # fmt: skip
"""What someone who knows metrology alone asks about a machine, and where the report answers."""


@pytest.mark.parametrize('question', TEN_QUESTIONS)
def test_ten_questions_are_answered_by_the_report_alone(page, question):
    assert re.search(TEN_QUESTIONS[question], page.text.replace('\u00a0', ' ')), question


# ---------------------------------------------------------------- numbers agree


@pytest.mark.parametrize('motion', MOTIONS)
def test_nodes_in_the_page_are_those_of_json_and_csv(page, tables, folder, motion):
    unit = 'µm' if motion.is_translation else 'µrad'
    shown = page.rows(f'{motion} ({unit})')
    entry = tables['motions'][motion]
    csv = [
        line.split(',')
        for line in (folder / 'error_tables.csv').read_text().splitlines()
        if line.startswith(motion)
    ]
    assert len(shown) == len(entry['value']) == len(csv)
    for k, (row, line) in enumerate(zip(shown, csv, strict=True)):
        for column, key in ((1, 'value'), (2, 'u')):
            assert abs(number(row[column]) - 1e6 * entry[key][k]) < 5.1e-4
        assert number(row[0]) == pytest.approx(1e3 * entry['position'][k], abs=1e-3)
        known = [f'{entry.get("k") or 0:.2f}']
        assert row[4:5] == (['-'] if entry['k'] is None else known)
        assert float(line[2]) == pytest.approx(entry['position'][k], abs=1e-15)
        assert [float(line[n]) for n in (4, 6)] == [entry['value'][k] + 0.0, entry['u'][k]]
        seen = entry['identifiable'] and entry.get('node_identifiable', {k: True})[k]
        assert (row[7] in {'ok', 'few data'}) == seen


def test_squareness_in_the_page_is_that_of_json_in_both_habits_of_sign(page, tables, result):
    rows = {row[0]: row for row in page.rows('Squareness')}
    for name, sign in (('C0Y', 1), ('B0Z', -1), ('A0Z', 1)):
        entry = tables['squareness'][name]
        value, other, wide, u = map(number, rows[name][1:5])
        assert value == pytest.approx(1e6 * entry['value'], abs=0.06 * wide)
        assert other == pytest.approx(sign * value)
        assert wide == pytest.approx(1e6 * result.expanded[name][0], rel=0.06)
        assert u == pytest.approx(1e6 * entry['u'], rel=0.06)
        assert wide == pytest.approx(2 * u, rel=0.06)
        offset = '(20, −30, −150) mm'
        holds = {'C0Y': 'ECY', 'B0Z': 'EBZ, ECZ', 'A0Z': 'EAZ, ECZ'}[name]
        assert (
            rows[name][5].replace('\u00a0', ' ') == f'at target offset {offset}, contains {holds}'
        )


def test_volumetric_error_agrees_in_page_terminal_and_json(page, tables, result):
    now, wide, alone, measured = (row[1:] for row in page.rows('Volumetric error'))
    sizes, first = ('mean', 'p95', 'max'), tables['headline']
    entry = first['error']
    U, own = ({k: 2 * v for k, v in first[u].items()} for u in ('u', 'u_run'))
    for row, values, digits in ((now, entry, U), (wide, U, U), (alone, own, own)):
        for cell, k in zip(row, sizes, strict=True):
            assert number(cell) == pytest.approx(1e6 * values[k], abs=0.06e6 * digits[k])
            assert len(cell.replace('.', '').lstrip('0')) == 2 or row is now, 'two digits of U'
    assert all(number(b) < number(a) for a, b in zip(wide, alone, strict=True))
    assert measured[0] == 'not measured'
    assert result.headline.sentences[0] in otf_core.summary(result)


def test_budget_of_the_volume_agrees_and_its_squares_add_up(page, tables):
    entry = tables['budget']['u_rms']['grid']
    rows = page.rows('Error vector in the volume')
    parts = {row[0]: number(row[5]) for row in rows}
    for name, value in parts.items():
        assert value == pytest.approx(1e6 * entry['sources'][name], abs=5.1e-4)
    assert np.hypot.reduce([*parts.values()]) == pytest.approx(1e6 * entry['u'], abs=2e-3)
    assert sum(number(row[6]) for row in rows) == pytest.approx(100, abs=0.5)


def test_samples_of_the_page_add_up(page, tables):
    (row,) = page.rows('Data quality')
    assert 'Nothing was repaired or left out while reading.' in page.text
    samples, used, outliers, excluded = map(int, row[1:5])
    assert samples == used + outliers + excluded == tables['fit']['samples']
    assert used == tables['fit']['used']


def test_what_was_repaired_is_said_beside_the_data(cell):
    samples = cell.recording.measured(cell.truth)
    read = Recording(samples, cell.path, cell.machine, 'Monday', ('dropped 3 of 200 points',))
    result = calibrate_recordings([read])
    assert result.runs[0].remarks == read.remarks
    said = Page(calibration_page(result.to_dict())).text
    assert 'While reading Monday: dropped 3 of 200 points.' in said


# ---------------------------------------------------------------- single sections


def test_diagonals_of_a_stretched_axis_are_those_of_geometry(cell):
    machine = some_machine()
    plain = constant_tables(machine)
    x = plain.motions['EXX']
    stretched = replace(
        plain, motions={**plain.motions, 'EXX': replace(x, value=1e-5 * x.position)}
    )
    size = sum(len(m.position) for m in stretched.motions.values()) + 3
    result = SimpleNamespace(tables=stretched, covariance=np.zeros((size, size)))
    span = machine.upper - machine.lower
    found = diagonals(machine)
    assert [kind for kind, *_ in found] == ['body'] * 4 + ['face'] * 6
    for _, _, a, b in found:
        value, u = deviations(result, a, b)
        length = np.linalg.norm(b - a)
        expected = 1e-5 * span[0] ** 2 / length if a[0] != b[0] else 0.0
        assert value[-1] == pytest.approx(expected, abs=1e-12)
        assert u[-1] == 0


def test_drift_of_a_run_is_found_with_its_uncertainty(result):
    run = result.runs[0]
    time = run.pieces.time
    moved = np.outer(time / time.max(), [8e-6, 0.0, -4e-6])
    residual = run.residual + np.einsum('cpk,pk->cp', run.axes, moved)
    at, value, u = drift(replace(run, residual=residual))
    change, share = value[-1] - value[0], (at[-1] - at[0]) / time.max()
    assert np.all(
        np.abs(change - share * np.array([8e-6, 0.0, -4e-6])) < 4 * np.hypot(u[-1], u[0])
    )
    assert np.all(u < 2e-6)
    assert len(at) >= 4


def test_a_calibration_can_do_without_a_report(result, tmp_path):
    files = write_calibration(result, tmp_path, report=False)
    assert not (tmp_path / 'report.html').exists()
    assert all(f.exists() for f in files)


def test_a_tracker_that_moved_is_said_beside_the_drift(result):
    moved = replace(result, warnings=('moved: tracker or target moved 20 s after the start',))
    said = Page(calibration_page(moved.to_dict())).text
    assert 'Moved: tracker or target moved 20 s after the start.' in said


# ---------------------------------------------------------------- order, units, pictures


def test_positions_are_in_mm_wherever_people_read(source, page):
    heads = [cell for _, rows in page.tables for cell in rows[0]]
    assert {'Position (mm)', 'Travel', 'Length (mm)'} <= set(heads)
    assert any(row[0] == 'X (mm)' for _, rows in page.tables for row in rows)
    assert [head for head in heads if '(m)' in head or 'm/s' in head] == []
    labels = re.findall(r'<text[^>]*>([^<]+)</text>', source)
    assert [said for said in labels if re.search(r'\(m\)|\d[\s]m$|m/s', said)] == []
    assert 'X 0 to 300\u00a0mm' in labels
    said = page.text
    assert not re.search(r'[XYZ] [−\d.]+ m\b', said)
    assert re.search(r'tracker at X [−\d.]+, Y [−\d.]+, Z [−\d.]+ mm', said)
    assert not re.search(r'\dum\b|\bum\b|\burad\b', said)


def test_the_page_of_the_file_is_that_of_the_verb(folder, source):
    assert pages_of(folder / 'error_tables.json')['report.html'] == source


def test_all_errors_are_bars_with_u_and_the_limits_that_are_stated(source, tables):
    bars = re.findall(r'<svg[^>]*aria-label="size of all errors in µ[^"]+"', source)
    assert len(bars) == 2 and len(tables['sizes']) == 21
    shown = re.findall(r'<text[^>]*>([^<]*, limit [^<]*)</text>', source)
    assert len([said for said in shown if '±' in said]) == 2
    assert 'class="area bad"' in source and 'class="area good"' in source


def test_first_comes_the_volume_then_all_errors_then_the_sections(source):
    order = [source.index(said) for said in
             ('error vectors in the volume', 'All 21 errors', '<nav', 'id="motions"',
              'id="budget"', 'id="conventions"', 'id="nodes"')]  # fmt: skip
    assert order == sorted(order)
    assert '@top-left { content: "small, run ' in source


def test_figures_after_iso_230_2_are_those_of_both_directions(result):
    motions = {}
    for axis, size in zip(AXES, (4e-6, -2e-6, 0.0), strict=True):
        table = result.tables.motions[f'E{axis}{axis}']
        width = np.full(len(table.position), size)
        motions[f'E{axis}{axis}'] = ReversalTable(table.position, width, 0 * width, True)
    both = replace(result, reversal=Reversal('constant', {}, motions))
    rows = Page(calibration_page(both.to_dict())).rows('Derived, ISO 230-2 style')
    for row, size in zip(rows, (4.0, 2.0, 0.0), strict=True):
        mean = 1e6 * np.ptp(result.tables.motions[f'E{row[0]}{row[0]}'].value)
        assert [number(v) for v in row[2:5]] == pytest.approx([mean + size, mean, size], abs=0.011)

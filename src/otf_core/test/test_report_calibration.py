# SPDX-License-Identifier: Apache-2.0
"""The report of a calibration: complete, self-contained, and its numbers those of the files."""

import json
import pkgutil
import re
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import constant_tables, some_machine
from html_cells import Page, number, unloading

import otf_core
import otf_core.reports.calibration_sections as of_calibration
import otf_core.reports.gap_sections as of_gap
from otf_core.calibration.calibrate import calibrate, calibrate_runs
from otf_core.model.expanded import figure
from otf_core.model.machine import AXES
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.sections import Circumstances, DeclaredUncertainty, Limits
from otf_core.pieces.runs import Recording
from otf_core.reports import diagnosis
from otf_core.reports.calibration import (
    SECTIONS,
    calibration_sections,
    facts_of,
    write_calibration,
)
from otf_core.reports.calibration_sections.first_screen import error_sizes
from otf_core.reports.calibration_sections.measurement import drift
from otf_core.reports.calibration_sections.volumetric_error import deviations, diagonals
from otf_core.reports.drawing import scene
from otf_core.reports.drawing.panel import HEAD, SPREAD
from otf_core.reports.page import sections_to_dict
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


@pytest.mark.parametrize(
    ('folder', 'listed'),
    [(of_calibration, SECTIONS), (of_gap, diagnosis.SECTIONS)],
    ids=['calibration', 'diagnosis'],
)
def test_every_section_is_in_the_report(folder, listed):
    names = [m.name for m in pkgutil.iter_modules(folder.__path__)]
    modules = [import_module(f'{folder.__name__}.{name}') for name in names]
    sections = {v for m in modules for k, v in vars(m).items() if k.endswith('_section')}
    assert sections == set(listed)
    assert len(sections) == len(listed)


def test_sections_are_named_once_and_hold_plain_data(result):
    sections = calibration_sections(facts_of(result))
    names = [s.name for s in sections]
    assert len(names) == len(set(names))
    json.dumps(sections_to_dict(sections), allow_nan=False)


# ---------------------------------------------------------------- what a report has to state

MINIMAL = {
    'measurand and convention': (
        'ISO 230-1', 'actual minus nominal', 'The reference point', 'w-b-X-Y-Z-t', 'Gauge',
        'not corrected to 20',
    ),
    'per node': ('Position', 'u (k = 1)', 'U', 'k', 'v_eff', 'n_obs', 'Flag'),
    'scalars': ('C0Y', 'B0Z', 'A0Z', 'angle between +X and +Y is 90°', 'tracker scale'),
    'fit': (
        'samples used', 'outliers', 'N_eff', 'unknowns', 'rank', 'condition number', 's0',
        'chi-square p', 'residual rms', 'a2', 'a3', 'correlation time',
    ),
    'correlation': ('correlated by at least 0.5', 'more than 0.8', 'least certain'),
    'volumetric': (
        'Mean', '95 % below', 'Largest', 'as found', 'expected after compensation',
        'measured after compensation', 'has U =',
    ),
    'budget': (
        'Source', 'Type', 'Distribution', 'uncertainty stated', 'Sensitivity', 'Share', 'dof',
        'Correlated',
    ),
    'conditions': (
        'air temperature 20.4 °C', 'air pressure 101200 Pa', 'relative humidity 45 %',
        'temperature of the machine 20.9 °C', 'warm-up time 3600 s', 'feed', 'duration',
        'SHA-256 of run', 'closure of start and end',
    ),
    'instrument': (
        'AT <960>', '750123', '7.1', '2026-03-01', '15 µm + 6 µm/m', 'ADM', 'RRR 42',
    ),
    'statement': (
        'expanded uncertainty', 'JCGM 100', 'JCGM 102', 'k = ', 'degrees of freedom', '95 %',
        'error_tables.json', 'Decision rule', 'otf_core',
    ),
}  # fmt: skip
"""Minimal reporting set: what JCGM 100, ISO 230 and ISO 14253 readers look for."""


@pytest.mark.parametrize('item', MINIMAL)
def test_every_field_of_the_minimal_reporting_set_is_there(page, item):
    said = page.text.replace('\u00a0', ' ')
    assert [part for part in MINIMAL[item] if part not in said] == []


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
        assert row[4:5] == (['-'] if 'k' not in entry else known)
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
    result = calibrate_runs([read])
    assert result.runs[0].remarks == read.remarks
    (data,) = [s for s in calibration_sections(facts_of(result)) if s.name == 'data']
    assert 'While reading Monday: dropped 3 of 200 points.' in data.words


# ---------------------------------------------------------------- single sections


def test_diagonals_of_a_stretched_axis_are_those_of_geometry(cell):
    machine = some_machine()
    plain = constant_tables(machine)
    x = plain.motions['EXX']
    stretched = replace(
        plain, motions={**plain.motions, 'EXX': replace(x, value=1e-5 * x.position)}
    )
    size = sum(len(m.position) for m in stretched.motions.values()) + 3
    facts = SimpleNamespace(
        tables=stretched, result=SimpleNamespace(covariance=np.zeros((size, size)))
    )
    span = machine.upper - machine.lower
    found = diagonals(machine)
    assert [d.kind for d in found] == ['body'] * 4 + ['face'] * 6
    for one in found:
        value, u = deviations(facts, one)
        length = np.linalg.norm(one.b - one.a)
        expected = 1e-5 * span[0] ** 2 / length if one.a[0] != one.b[0] else 0.0
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


def test_figures_after_iso_230_2_are_those_of_both_directions(result):
    tables = result.tables
    motions = {}
    for axis, size in zip(AXES, (4e-6, -2e-6, 0.0), strict=True):
        table = tables.motions[f'E{axis}{axis}']
        width = np.full(len(table.position), size)
        motions[f'E{axis}{axis}'] = ReversalTable(table.position, width, 0 * width, True)
    both = replace(result, reversal=Reversal('constant', {}, motions))
    found = sections_to_dict(calibration_sections(facts_of(both)))['reversal']['derived']
    for axis, size in zip(AXES, (4e-6, 2e-6, 0.0), strict=True):
        mean = tables.motions[f'E{axis}{axis}'].value
        assert found[axis]['B'] == pytest.approx(size)
        assert found[axis]['M'] == pytest.approx(mean.max() - mean.min())
        assert found[axis]['E'] == pytest.approx(mean.max() - mean.min() + size)


def test_the_script_turns_what_was_drawn():
    code = scene.SCRIPT
    assert f'{np.degrees(scene.AZIMUTH):.0f} * Math.PI' in code
    assert f'{np.degrees(scene.ELEVATION):.0f} * Math.PI' in code
    assert f'box.height / 2 - {scene.MARGIN:.0f};' in code
    assert f'Math.cos({SPREAD})' in code
    assert f'Math.min({HEAD:.0f},' in code


def test_a_calibration_can_do_without_a_report(result, tmp_path):
    files = write_calibration(result, tmp_path, report=False)
    assert not (tmp_path / 'report.html').exists()
    assert all(f.exists() for f in files)


def test_largest_motions_are_said_with_place_and_uncertainty(page, tables, result):
    facts = facts_of(result)
    said = page.text.replace('\u00a0', ' ')
    for kind, unit in (('displacement', 'm'), ('rotation', 'rad')):
        name, value, u, axis, at = re.search(
            rf'Largest {kind}: (E..), [a-z A-Z]+, ([\d.−]+) ± ([\d.]+) \S+ '
            r'at ([XYZ]) ([\d.−]+) mm',
            said,
        ).groups()
        motions = {m: e for m, e in tables['motions'].items() if e['unit'] == unit}
        sizes = {m: max(map(abs, e['value'])) for m, e in motions.items()}
        assert name == max(sizes, key=sizes.get) and axis == name[2]
        entry = motions[name]
        k = entry['position'].index(pytest.approx(1e-3 * number(at)))
        wide = 1e6 * facts.result.expanded[name][k]
        assert (number(value), float(u)) == (
            float(figure(1e6 * entry['value'][k], wide)), float(figure(wide, wide)),
        )  # fmt: skip
        assert wide == pytest.approx(1e6 * entry['k'] * entry['u'][k])


def test_a_tracker_that_moved_is_said_beside_the_drift(result):
    moved = replace(result, warnings=('moved: tracker or target moved 20 s after the start',))
    drift_words = {s.name: s.words for s in calibration_sections(facts_of(moved))}['drift']
    assert 'Moved: tracker or target moved 20 s after the start.' in drift_words


# ---------------------------------------------------------------- order, units, pictures


def part(source, name):
    """A section of the page."""
    return re.search(rf'<section id="{name}">(.*?)</section>', source, re.DOTALL)[1]


def test_page_one_is_volume_and_all_errors_then_motions_then_conventions(source):
    names = re.findall(r'<section id="([^"]+)"', source)
    assert names[:4] == ['overview', 'limits', 'motions', 'squareness']
    assert names.index('conventions') > names.index('volume')
    first = part(source, 'overview')
    drawn = re.findall(r'aria-label="([^"]+)"', first)
    assert drawn == [
        'error vectors in the volume', 'uncertainty after compensation in the volume',
        'size of all errors in µm', 'size of all errors in µrad',
    ]  # fmt: skip
    assert first.index('<svg') < first.index('Worst:')


def test_volume_before_and_after_stand_at_one_magnification_with_a_tracker(source):
    scenes = re.findall(r'<svg class="turn".*?</svg>', part(source, 'overview'), re.DOTALL)
    before, after = (re.search(r'>(\d+)\u00a0µm, errors × ([\d\u202f]+)<', s) for s in scenes)
    assert before.groups() == after.groups()
    assert all('>tracker' in s for s in scenes)


def test_all_21_errors_are_bars_with_u_and_the_limits_that_are_stated(page, result, source):
    sizes = {one.name: one for one in error_sizes(facts_of(result))}
    assert list(sizes) == [*MOTIONS, *SQUARENESS]
    first = part(source, 'overview')
    for name, one in sizes.items():
        assert f'>{name}{"*" if one.bound else ""}</text>' in first
        if one.known:
            table = result.tables.motions.get(name)
            value = abs(result.tables.squareness[name].value) if table is None else (
                table.value.max() - table.value.min()
            )  # fmt: skip
            assert one.value == pytest.approx(value)
            assert one.U > 0
    bound = result.offset_bound
    assert {n for n, one in sizes.items() if one.bound} == set(bound.contains) != set()
    assert f'* {bound.sentence}.' in page.text.replace('\N{MINUS SIGN}', '-')
    judged = {one.name: one for one in result.verdicts.machine.limits}
    for name in ('EXX', 'C0Y'):
        assert (sizes[name].value, sizes[name].U, sizes[name].state) == (
            judged[name].value, judged[name].U, judged[name].state,
        )  # fmt: skip
    assert ', limit 2</text>' in first
    assert ', limit 1000</text>' in first
    assert 'class="area bad"' in first and 'class="area good"' in first


def test_a_limit_is_drawn_in_the_picture_of_its_motion(source):
    motions = part(source, 'motions')
    (own,) = re.findall(r'<svg(?:(?!<svg).)*EXX positioning, limit 2.*?</svg>', motions, re.DOTALL)
    assert own.count('line bad dash') == 2
    assert motions.count('bad dash') == 2


def test_states_of_limits_are_coloured(source):
    assert '<b class="bad">fail</b>' in part(source, 'limits')
    assert '<b class="good">pass</b>' in part(source, 'limits')


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


def test_no_correlation_is_coloured_for_a_motion_that_is_not_known(result, source):
    hidden = set(result.not_identifiable)
    names = [*SQUARENESS, *MOTIONS]
    pairs = [(a, b) for k, a in enumerate(names) for b in names[:k]]
    shown = [p for p in pairs if not hidden & set(p)]
    assert hidden
    assert part(source, 'correlations').count('class="area heat') == len(shown) < len(pairs)


def test_paper_has_machine_run_and_date_in_its_head(source, result):
    rule = re.search(r'@top-left \{ content: "([^"]*)"', source)[1]
    assert rule.startswith(f'small, run {result.run_id}, ')
    assert 'counter(page)' in source

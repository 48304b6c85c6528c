# SPDX-License-Identifier: Apache-2.0
"""Every verb once, on small input: exit code, files, fields of its JSON."""

import json
import math
import re

import pytest
from command import ROOT, otf, read, refused
from golden import RECORDINGS

BACKLASH = RECORDINGS['backlash']
BAG, MACHINE = BACKLASH.bags[0], BACKLASH.machines[0]
VERBS = (
    *('check', 'info', 'doctor', 'calibrate', 'diagnose', 'predict', 'compare', 'export'),
    *('import', 'fleet', 'history', 'noise', 'plan', 'simulate', 'completion'),
)


def test_help_names_every_verb_and_fits_a_screen():
    done = otf('--help')
    assert done.code == 0
    assert all(re.search(rf'^ +{verb}\b', done.out, re.MULTILINE) for verb in VERBS)


@pytest.mark.parametrize('verb', VERBS)
def test_help_of_a_verb_shows_examples_that_begin_with_it(verb):
    done = otf(verb, '--help')
    assert done.code == 0
    assert re.search(rf'^  otf {verb}\b', done.out, re.MULTILINE)


def test_check_says_usable_or_what_is_wrong():
    done = otf('check', BAG, '--machine', MACHINE, '--json')
    found = done.document
    assert (done.code, found['usable']) == (0, True)
    assert found['rate_hz'] == pytest.approx(40, abs=0.1)
    assert found['gaps'] == 0 and found['coverage'] > 0.99
    assert all(set(p) >= {'what', 'severity'} for p in found['problems'])
    named = [p for p in found['problems'] if p['severity'] == 'error']
    assert not named


@pytest.mark.parametrize(
    ('path', 'word'),
    [(BAG, '9083'), (MACHINE, 'cell-300'), (BACKLASH.truth, 'otf-error-tables')],
    ids=['bag', 'machine', 'tables'],
)
def test_info_names_what_a_file_is(path, word):
    done = otf('info', path, '--json')
    assert done.code == 0
    assert word in done.out


def test_doctor_answers_without_a_recording():
    done = otf('doctor', '--json')
    assert done.code in (0, 2, 3, 4)
    assert done.document


def test_calibrate_writes_tables_report_and_csv_as_described(result_of):
    result = result_of('backlash')
    document = result.document
    assert document['schema'].startswith('otf-error-tables/')
    assert set(document['squareness']) == {'C0Y', 'B0Z', 'A0Z'}
    assert len(document['motions']) == 18
    for name, own in document['motions'].items():
        assert own['axis'] == name[2]
        assert own['unit'] == ('m' if name[1] in 'XYZ' else 'rad')
        assert len(own['position']) == len(own['value']) == len(own['u'])
    rotation = document['alignment']['rotation']
    assert sum(v * v for row in rotation for v in row) == pytest.approx(3)
    fit = document['fit']
    assert fit['rank'] <= fit['unknowns'] and fit['used'] <= fit['samples'] == 9083
    assert 0 < fit['path_mae_after'] < fit['path_mae_before']
    assert {'report.html', 'error_tables.json', 'error_tables.csv'} <= {
        path.name for path in result.folder.iterdir()
    }


def test_diagnose_writes_a_gap_of_the_documented_fields(result_of):
    document = result_of('explained').document
    assert document['schema'] == 'otf-gap/1'
    gap = document['gap']
    before = math.sqrt(max(0.0, gap['measured_um'] ** 2 - gap['simulated_um'] ** 2))
    assert gap['before_um'] == pytest.approx(before, rel=1e-3)
    assert 0 <= gap['shrink_interval_percent'][0] <= gap['shrink_interval_percent'][1] <= 100
    (cause,) = document['causes']
    assert 0 <= cause['confidence'] <= 1 and isinstance(cause['indistinguishable_from'], list)
    assert {entry['effect'] for entry in document['not_visible']} >= {'tracker_scale'}
    assert set(document['where']) >= {'summary', 'by_time', 'by_path_piece', 'by_region'}


def test_predict_evaluates_tables_and_says_what_lies_inside(tables_file, tmp_path):
    tables = tables_file(EXX=(0.0, 5e-6, 1e-5), EBX=(0.0, 0.0, 2e-5), C0Y=2e-5)
    (tmp_path / 'points.csv').write_text('x,y,z\n0.3,0.2,-0.1\n0.075,0.0,0.0\n')
    out = tmp_path / 'errors.csv'
    done = otf('predict', '--tables', tables, '--points', tmp_path / 'points.csv', '--out', out)
    assert done.code == 0
    header, *rows = out.read_text().splitlines()
    assert header.split(',')[:6] == ['x', 'y', 'z', 'dx', 'dy', 'dz']
    assert {'u_dx', 'u_dy', 'u_dz'} <= set(header.split(','))
    first, second = ([float(v or 'nan') for v in row.split(',')[:6]] for row in rows)
    # e = t + r x (T + y + z); C0Y tilts +Y to -X
    lever = -0.15 - 0.1
    assert first[3:6] == pytest.approx([1e-5 + 2e-5 * lever - 2e-5 * 0.2, 0.0, 0.0], abs=1e-12)
    assert second[3:6] == pytest.approx([2.5e-6, 0.0, 0.0], abs=1e-12)


def test_compare_states_difference_and_normalised_error(tables_file, tmp_path):
    one = tables_file(EXX=(0.0, 5e-6, 1e-5)).rename(tmp_path / 'one.json')
    other = tables_file(EXX=(0.0, 5e-6, 1.2e-5)).rename(tmp_path / 'other.json')
    done = otf('compare', one, other, '--out', tmp_path / 'out', '--json')
    assert done.code == 0
    own = done.document['motions']['EXX']
    assert own['largest_difference'] == pytest.approx(2e-6)
    # |b - a| / sqrt(U_a^2 + U_b^2), U = 2 u; u of 0.1 um at the node and at the zero of each
    assert own['normalised_error'][-1] == pytest.approx(2e-6 / (2 * math.sqrt(4 * 1e-14)))
    assert (tmp_path / 'out/report.html').exists()


def test_import_fits_the_lattice_that_export_writes(tables_file, machine_file, tmp_path):
    errors = {'EXX': (0.0, 5e-6, -4e-6), 'EYX': (0.0, 3e-6, 0.0), 'EZZ': (2e-6, 1e-6, 0.0)}
    lattice = tmp_path / 'lattice.csv'
    words = ('export', tables_file(**errors), '--format', 'lattice-csv', '--out', lattice)
    assert otf(*words).code == 0
    out = tmp_path / 'tables'
    assert otf('import', lattice, '--machine', machine_file, '--out', out).code == 0
    motions = read(out / 'error_tables.json')['motions']
    for name, values in errors.items():
        first = motions[name]['value'][0] - values[0]  # a rigid motion of the whole lattice
        found = [value - first for value in motions[name]['value']]
        assert found == pytest.approx(values, abs=2e-9), name


def test_noise_is_that_of_the_standstills(tmp_path):
    done = otf('noise', BAG, '--out', tmp_path / 'out', '--json')
    assert done.code == 0
    found = read(tmp_path / 'out/noise.json')
    assert found['schema'] == 'otf-noise/1' and found['standstills'] >= 2
    assert found['u_range'] == pytest.approx(0.5e-6, rel=0.3)
    assert found['u_angle'] == pytest.approx([2e-6, 2e-6], rel=0.3)
    assert 0 < found['white_range'] <= found['u_range']


def test_plan_forecasts_names_what_is_hidden_and_writes_a_program(tmp_path):
    plan = ('plan', '--machine', MACHINE, '--out', tmp_path / 'out', '--feed', 15000)
    done = otf(*plan, '--dialect', 'linuxcnc', '--tracker-place', '0.15,-0.3,-0.1', '--json')
    assert done.code == 0
    found = read(tmp_path / 'out/plan.json')
    hidden = {name for name, own in found['forecast']['errors'].items() if not own['identifiable']}
    assert hidden == {'ECX', 'EAZ', 'EBZ', 'ECZ'}
    assert found['assumed']['tracker_place'] == [0.15, -0.3, -0.1]
    (program,) = (tmp_path / 'out').glob('*.ngc')
    assert re.search(r'F15000', program.read_text())
    assert (tmp_path / 'out/report.html').exists()


def test_simulate_writes_a_bag_that_other_verbs_read(tmp_path):
    path = tmp_path / 'path.csv'
    path.write_text('x,y,z\n0,0,-0.2\n0.3,0.2,0\n0.3,0,-0.2\n0,0.2,0\n')
    words = ('--machine', MACHINE, '--path', path, '--rate', 50, '--seed', 4, '--feed', 12000)
    done = otf('simulate', *words, '--out', tmp_path / 'run', '--json')
    assert done.code == 0
    truth = read(tmp_path / 'run/truth_tables.json')
    assert truth['machine']['chain'] == 'w-Y-b-X-Z-t'
    again = otf('simulate', *words, '--out', tmp_path / 'again')
    assert again.code == 0
    bags = [next((tmp_path / name).glob('*.mcap')).read_bytes() for name in ('run', 'again')]
    assert bags[0] == bags[1]
    assert str(done.document['samples']) in otf('info', tmp_path / 'run').out


def test_fleet_goes_on_after_a_bad_bag(tmp_path):
    rows = [f'good,{BAG},{MACHINE}', f'bad,{tmp_path / "missing"},{MACHINE}']
    (tmp_path / 'runs.csv').write_text('\n'.join(['name,bag,machine', *rows, '']))
    words = ('fleet', 'calibrate', '--list', tmp_path / 'runs.csv', '--workers', 1)
    done = otf(*words, '--out', tmp_path / 'out')
    assert done.code == 4
    found = read(tmp_path / 'out/fleet.json')
    assert (found['done'], found['failed']) == (1, 1)
    assert found['runs']['bad']['exit'] in (2, 3) and 'missing' in found['runs']['bad']['message']
    assert len(found['runs']['good']['sha256']) == 64
    assert (tmp_path / 'out/good/error_tables.json').exists()


def test_history_keeps_runs_and_never_the_same_twice(result_of, tmp_path):
    store, result = tmp_path / 'store', result_of('backlash')
    assert otf('history', store, '--add', result.folder).code == 0
    assert otf('history', store, '--event', 'belt of X replaced', '--at', '2026-11-02').code == 0
    done = otf('history', store, '--json')
    assert done.code == 0
    assert 'cell-300' in done.out and 'belt of X replaced' in done.out
    assert len(done.document['machines'][0]['runs']) == 1
    assert otf('history', store, '--add', result.folder).code in (0, 2, 3)
    (machine,) = otf('history', store, '--json').document['machines']
    assert len(machine['runs']) == 1


@pytest.mark.parametrize('shell', ['bash', 'zsh'])
def test_completion_is_a_script_with_every_verb(shell):
    done = otf('completion', shell)
    assert done.code == 0
    assert all(verb in done.out for verb in VERBS)


def test_launcher_of_the_repository_knows_the_verbs():
    import subprocess
    import sys

    done = subprocess.run(
        [sys.executable, ROOT / 'otf', '--help'], capture_output=True, text=True, check=True
    )
    assert all(re.search(rf'^ +{verb}\b', done.stdout, re.MULTILINE) for verb in VERBS)


EXPORTS = {
    'linuxcnc': ((), 'c_x.comp', r'^300\.0+ +300\.010'),
    'sinumerik-enc': ((), 'c.ini', r'\[0,2,X1\]=0\.010'),
    'sinumerik-cec': (('--sign', 'error'), 'c.ini', r'\[2,2\]=-0\.004'),
    'isg': (('--sign', 'error'), 'c.ini', r'^300\.0+\s+0\.010'),
    'etalon': ((), 'c.ini', r'^300\.0+ +0\.010'),
    'lattice-csv': ((), 'c.ini', r'^0\.3,0\.0,0\.0,1e-05,'),
}
"""Format: options, a file, and what EXX of 10 um at 0.3 m, or C0Y of 20 urad, is in it."""


@pytest.mark.parametrize('name', EXPORTS)
def test_export_has_the_stated_sign_and_what_remains(tables_file, tmp_path, name):
    options, file, line = EXPORTS[name]
    tables = tables_file(EXX=(0.0, 5e-6, 1e-5), C0Y=2e-5)
    words = ('export', tables, '--format', name, '--out', tmp_path / 'c.ini', *options)
    done = otf(*words, '--json')
    assert done.code == 0
    found = done.document
    assert found['sign'] and found['lacks']
    left = found['remaining']
    assert 0 <= left['after_mean_um'] <= left['before_mean_um']
    assert re.search(line, (tmp_path / file).read_text(), re.MULTILINE)


def test_correction_is_the_error_with_the_other_sign(tables_file, tmp_path):
    tables = tables_file(EXX=(0.0, 5e-6, 1e-5))
    words = ('export', tables, '--format', 'isg', '--out', tmp_path / 'isg.csv')
    refused(otf(*words), 2, '--sign', written=[tmp_path / 'isg.csv'])
    assert otf(*words, '--sign', 'correction').code == 0
    assert re.search(r'^300\.0+\s+-0\.010', (tmp_path / 'isg.csv').read_text(), re.MULTILINE)


def test_pivot_of_a_rotary_table_moves_by_its_location_errors(result_of, tmp_path):
    result = result_of('rotary-table')
    out = tmp_path / 'pivot.txt'
    done = otf('export', result.folder, '--format', 'pivot', '--out', out, '--json')
    assert done.code == 0 and done.document['sign']
    moved = 1e3 * result.document['location']['X0C']['value']  # mm; the centre is at zero
    numbers = [float(n) for n in re.findall(r'-?\d+\.\d+', out.read_text())]
    assert min(abs(n - moved) for n in numbers) < 1e-5


@pytest.mark.parametrize('name', ['backlash', 'explained'])
def test_report_is_one_page_that_needs_no_network(result_of, name):
    page = (result_of(name).folder / 'report.html').read_text(encoding='utf-8')
    assert page.lstrip().lower().startswith('<!doctype html')
    loaded = r'<(?:script|link|img|iframe|source)[^>]+(?:src|href)="(?!data:|#)'
    assert not re.search(loaded, page)
    assert not re.search(r'@import|url\(["\']?http', page)


def test_json_of_a_failed_command_is_an_object_with_its_exit_code(tmp_path):
    words = ('calibrate', tmp_path / 'nowhere', '--machine', MACHINE, '--out', tmp_path / 'out')
    done = otf(*words, '--json')
    assert done.document['exit'] == done.code and done.code in (2, 3)
    assert 'nowhere' in done.document['error'] and done.document['verb'] == 'calibrate'
    assert not (tmp_path / 'out').exists()


def test_quiet_says_nothing_and_verbose_says_more(tables_file, tmp_path):
    tables = tables_file(EXX=(0.0, 5e-6, 1e-5))
    words = ('compare', tables, tables, '--out')
    assert otf(*words, tmp_path / 'a', '--quiet').out == ''
    assert json.loads(otf(*words, tmp_path / 'b', '--json').out)['verb'] == 'compare'

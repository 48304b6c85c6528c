# SPDX-License-Identifier: Apache-2.0
"""What the project must never lose, row by row; the live part of it is in ``nodes``."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import otf, read
from golden import RECORDINGS, departures, golden_file, reduced

import otf_core

TWO = RECORDINGS['two-targets']
FIRST, MACHINE = TWO.bags[0], TWO.machines[0]


@pytest.fixture(scope='module')
def recording():
    """A run of two laps, the second backwards: 5677 samples."""
    return otf_core.read_bag(FIRST, otf_core.load_machine(MACHINE))


def calibrated(folder, recording, *xyz, stamps=None):
    """Exit code and document of the samples, one list after another, as one bag."""
    count = sum(len(part) for part in xyz)
    step = int(np.median(np.diff(recording.samples.stamp_ns)))
    stamp_ns = (
        recording.samples.stamp_ns[0] + step * np.arange(count) if stamps is None else stamps
    )
    samples = otf_core.Samples(stamp_ns, np.concatenate(xyz))
    otf_core.write_bag(replace(recording, samples=samples), folder / 'run')
    done = otf('calibrate', folder / 'run', '--machine', MACHINE, '--out', folder / 'out')
    assert (folder / 'out').exists(), done.said
    return done, read(folder / 'out/error_tables.json')


def share_left(folder, file=None):
    """Mean of the true volumetric error that the tables leave, as a share."""
    file = file or folder / 'out/error_tables.json'
    done = otf('compare', file, TWO.truth, '--out', folder / 'compared', '--json')
    left = done.document['volume_with_squareness']
    return left['mae_difference'] / left['mae_b']


def test_no_clock_is_in_common(recording, tmp_path):
    samples = recording.samples
    since = samples.stamp_ns - samples.stamp_ns[0]
    slow = 86_400_000_000_000 + np.rint(since * 1.0001).astype(np.int64)  # 1970, 100 ppm
    results = []
    for name, stamps in (('own', samples.stamp_ns), ('other', slow)):
        (tmp_path / name).mkdir()
        done, document = calibrated(tmp_path / name, recording, samples.xyz, stamps=stamps)
        results.append(reduced(done.code, document))
    said, _ = departures(*results)
    assert not said, said


def test_any_order_of_driving_with_laps_gaps_and_backward(recording, tmp_path):
    xyz = recording.samples.xyz
    back, half = xyz[::-1], len(xyz) // 2
    done, document = calibrated(tmp_path, recording, back[:700], back[900:], xyz[:half])
    assert done.code == 0, done.said
    assert document['fit']['coverage'] > 0.9
    assert share_left(tmp_path) < 0.04


def test_recordings_of_an_interrupted_run_are_joined(recording, tmp_path):
    samples, third = recording.samples, len(recording.samples) // 3
    for name, own in (('a', slice(0, third)), ('b', slice(third, None))):
        part = otf_core.Samples(samples.stamp_ns[own], samples.xyz[own])
        otf_core.write_bag(replace(recording, samples=part), tmp_path / name)
    words = ('calibrate', tmp_path / 'a', tmp_path / 'b', '--machine', MACHINE, '--join')
    done = otf(*words, '--out', tmp_path / 'out')
    assert done.code == 0, done.said
    assert read(tmp_path / 'out/error_tables.json')['fit']['samples'] == len(samples)
    assert share_left(tmp_path) < 0.03


def test_motions_that_the_data_hide_are_named_and_zero(result_of):
    document = result_of('backlash').document
    hidden = {name for name, own in document['motions'].items() if not own['identifiable']}
    assert hidden == set(document['not_identifiable']) == {'ECX', 'EAZ', 'EBZ', 'ECZ'}
    assert not any(v for name in hidden for v in document['motions'][name]['value'])


def test_a_second_target_and_place_show_what_one_hides(result_of):
    document = result_of('two-targets').document
    assert {'EAZ', 'EBZ'}.isdisjoint(document['not_identifiable'])
    assert len(document['runs']) == 2


def test_uncertainty_has_a_budget_by_source(result_of):
    grid = result_of('backlash').document['budget']['u_rms']['grid']
    sources = grid['sources']
    assert {'noise', 'misfit'} <= set(sources)
    assert sum(v * v for v in sources.values()) ** 0.5 == pytest.approx(grid['u'], rel=0.2)


def test_declared_contributions_enter_the_uncertainty(tmp_path):
    machine = tmp_path / 'declared.yaml'
    section = 'uncertainty: {preset: workshop}\n'
    machine.write_text(Path(MACHINE).read_text() + section)
    done = otf('calibrate', FIRST, '--machine', machine, '--out', tmp_path / 'out', '--json')
    assert done.code == 0, done.said
    document = read(tmp_path / 'out/error_tables.json')
    own = document['motions']['EXX']
    assert own['u'][-1] > 2 * 0.5e-6  # air and machine temperature: more than noise
    assert document['headline']['u']['mean'] > 1e-6


def test_reversal_is_chosen_on_lines_that_were_not_fitted(result_of):
    assert result_of('backlash').document['reversal']['model'] == 'constant'
    assert result_of('moved-tracker').document['reversal']['model'] == 'none'
    rows = (result_of('backlash').folder / 'error_tables.csv').read_text()
    assert 'EXX' in rows


def test_move_of_the_tracker_is_found_with_its_time_and_size(result_of):
    said = ' '.join(result_of('moved-tracker').document['warnings'])
    assert '113.' in said and '49.' in said  # s after the start, um


def test_wrong_order_of_axes_is_named_with_the_one_that_fits(tmp_path):
    machine = tmp_path / 'other.yaml'
    machine.write_text(Path(MACHINE).read_text().replace('w-Y-b-X-Z-t', 'w-b-X-Y-Z-t'))
    done = otf('calibrate', FIRST, '--machine', machine, '--out', tmp_path / 'out')
    assert done.code == 4 and 'w-Y-b-X-Z-t' in done.said, done.said


def test_unknown_is_an_answer_that_says_where(result_of):
    document = result_of('unknown').document
    assert document['verdict'] == 'unknown' and document['causes'] == []
    assert document['unexplained']['rms_um'] > 2.0
    assert document['any_cause']['p_value'] < 0.01 if 'any_cause' in document else True


def test_forecast_of_a_plan_is_what_its_run_gives(result_of, tmp_path):
    words = ('plan', '--machine', RECORDINGS['backlash'].machines[0], '--out', tmp_path / 'plan')
    recording = otf_core.read_bag(
        RECORDINGS['backlash'].bags[0], otf_core.load_machine(RECORDINGS['backlash'].machines[0])
    )
    rows = '\n'.join(','.join(map(repr, row)) for row in recording.path.points.tolist())
    (tmp_path / 'path.csv').write_text(f'x,y,z\n{rows}\n')
    done = otf(*words, '--path', tmp_path / 'path.csv', '--tracker-place', '0.15,-0.3,-0.1')
    assert done.code == 0
    expected = read(tmp_path / 'plan/plan.json')['forecast']['mean_grid_u']
    alone = result_of('backlash').document['headline']['u_run']['mean']
    assert 0.6 < alone / expected < 1.6


def test_result_says_what_it_was_made_of(result_of):
    document = result_of('backlash').document
    (run,) = document['provenance']['runs']
    assert run['samples'] == 9083 and len(run['sha256']) == 64
    assert run['first_stamp_ns'] == 1_700_000_000_000_000_000
    assert document['gauge'] and document['run_id']


def test_public_names_do_what_the_command_does(result_of):
    machine = otf_core.load_machine(RECORDINGS['backlash'].machines[0])
    recording = otf_core.read_bag(RECORDINGS['backlash'].bags[0], machine)
    result = otf_core.calibrate(recording)
    assert not result.failed_gates
    tables = result_of('backlash').document
    for name, own in tables['motions'].items():
        found = result.tables.motions[name].value
        np.testing.assert_allclose(found, own['value'], atol=1e-12)
    there = otf_core.predict(result, [[0.1, 0.1, -0.1]])
    assert there.error.shape == there.u.shape == (1, 3)
    assert 'cell-300' in otf_core.summary(result)


def test_golden_results_are_whole():
    for name in RECORDINGS:
        assert json.loads(golden_file(name).read_text())['exit'] == 0, name

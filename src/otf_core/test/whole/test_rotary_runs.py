# SPDX-License-Identifier: Apache-2.0
"""Whole calibrations of machines with rotary axes: recorded, simulated, with contradictions."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cli_cells import run
from rotary_cells import BAG, machine, parts, recorded, simulated, truth

import otf_core
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import PlannerConfig
from otf_core.effects import EVERY, AppliedEffect
from otf_core.errors import InputError
from otf_core.model.axis_path import AxisPath
from otf_core.model.chain import Sight, displacement
from otf_core.model.evaluation import evenly_spread
from otf_core.model.machine import facing_names, machine_from_dict
from otf_core.model.sections import Circumstances, DeclaredUncertainty
from otf_core.planning.chains import parts_of
from otf_core.planning.facings import facing_chains
from otf_core.planning.line_of_sight import default_tracker_place
from otf_core.prediction.uncertainty import prediction_uncertainty
from otf_core.reports.calibration import write_calibration
from otf_core.solving.tabulate import remove_rigid_motions
from otf_core.tracking.curve_matching import match, split_parts


@cache
def calibrated():
    return calibrate_recordings([recorded()])


def left(found, true, q):
    """Share of the errors at positions that tables leave, rigid motion of the table taken out."""
    e = displacement(true, q)
    d = displacement(found, q) - e
    rms = [
        float(np.sqrt(np.mean(remove_rigid_motions(true.machine, q, v.reshape(-1, 1)) ** 2)))
        for v in (d, e)
    ]
    return rms[0] / rms[1]


def test_recorded_trunnion_comes_out_as_it_is():
    result, true = calibrated(), truth()
    q = evenly_spread(machine().lower, machine().upper, 800)
    assert left(result.tables, true, q) < 0.05
    # its errors are straight between coarse nodes
    assert {n: len(t.position) for n, t in result.tables.motions.items()} == {
        n: len(t.position) for n, t in true.motions.items()
    }
    assert set(result.not_identifiable) == {'ECX', 'ECZ'}
    lean = result.tables.motions['EBZ']  # a spindle that leans is no rotation of Z near its zero
    there = np.interp(
        lean.position, *(getattr(true.motions['EBZ'], n) for n in ('position', 'value'))
    )
    off = lean.value - there + there[0]
    assert np.sqrt(np.mean(off**2)) < 2.0 * np.sqrt(np.mean(lean.u_run**2))
    assert all('spindle axis' in result.advice[n] for n in result.not_identifiable)
    assert not result.failed_gates and result.fit.inflation < 1.2
    d = displacement(result.tables, q) - displacement(true, q)
    away = remove_rigid_motions(machine(), q, d.reshape(-1, 1)).reshape(-1, 3)
    u = predict_u(result, q)
    assert np.mean(np.abs(away) < 2 * u) > 0.88
    assert np.sqrt(np.mean((away / u) ** 2)) > 0.35


def test_wrong_scale_of_the_tracker_acts_on_all_errors_as_the_budget_says():
    size = 1e-5
    declared = replace(machine(), uncertainty=DeclaredUncertainty({'tracker_scale': size}))
    recording = replace(recorded(), machine=declared)
    plain, samples = calibrated(), recording.samples
    wrong = replace(recording, samples=replace(samples, xyz=(1.0 + size) * samples.xyz))
    result = calibrate_recordings([wrong])
    budget, rows = result.budget, result.budget.rows
    assert np.allclose(budget.covariance, rows @ budget.whole @ rows.T + np.diag(budget.straight))
    assert 'tracker scale' not in result.typical.missing and 'air' in result.typical.missing
    scale = next(s for s in budget.sources if s.name == 'tracker scale')
    q = evenly_spread(machine().lower, machine().upper, 200)
    moved = displacement(result.tables, q) - displacement(plain.tables, q)
    part = replace(result, covariance_run=rows @ scale.covariance @ rows.T)
    expected = predict_u(part, q)
    assert expected.max() > 1e-6
    assert np.linalg.norm(np.abs(moved) - expected) < 0.1 * np.linalg.norm(expected)


def test_files_hold_residuals_budget_and_certificate(tmp_path):
    stated = replace(machine(), stated=Circumstances(certificate={'number': '2026-0117'}))
    result = replace(calibrated(), tables=replace(calibrated().tables, machine=stated))
    files = write_calibration(result, tmp_path, report=False)
    assert {'residuals.npz', 'certificate.html'} <= {f.name for f in files}
    with np.load(tmp_path / 'residuals.npz') as rows:
        assert rows['q'].shape == (result.fit.pieces, 5) and len(np.unique(rows['part'])) == 5
        left = np.linalg.norm(rows['residual'], axis=1)
    assert np.sqrt(np.mean(left**2)) == pytest.approx(result.fit.residual_rms)
    page = (tmp_path / 'certificate.html').read_text(encoding='utf-8')
    names = (*stated.motions, *stated.scalars)
    assert all(f'>{name}<' in page for name in names) and 'not known' in page
    data = json.loads((tmp_path / 'error_tables.json').read_text())
    entry, parts = data['location']['X0C'], data['budget']['u_rms']['X0C']
    assert entry['u'] == pytest.approx(parts['u'])
    own = sum(v**2 for n, v in parts['sources'].items() if not n.startswith('typical'))
    assert own == pytest.approx(entry['u_run'] ** 2, rel=0.05)  # nodes hold straight lines too
    assert data['systematic'] == data['headline']['systematic'] == 'typical'


def test_places_of_reflectors_and_tracker_are_found():
    data = json.loads((BAG / 'truth.json').read_text())
    for name, own in calibrated().targets.items():
        off = np.abs(own.place - np.array(data['targets'][name]['place']))
        known = machine().targets[name].u == 0.0
        assert np.all(off <= 2e-5), name  # the truth has its own gauge
        assert known == (not own.u.any())
    pose = calibrated().T_machine_tracker
    assert np.abs(pose.translation - np.array(data['alignment']['translation'])).max() < 5e-5


def predict_u(result, q):
    """Standard uncertainty of the predicted errors."""
    m, tables = machine(), result.tables
    nodes = {k: tables.motions[k].position for k in m.motions}
    return prediction_uncertainty(m, nodes, result.covariance_run, q)


@cache
def circles_only(tilted):
    """Lines with the tool; circles of C and arcs of A on three places, never both at once."""
    m, paths = machine(), []
    for part in parts():
        q = part.positions
        if part.target.startswith('nest'):
            a = (0.5, 1.2) if tilted else (0.0,)
            rows = [[0, 0, 0, a[0], 0]]
            for angle in a:
                rows += [[0, 0, 0, angle, c] for c in (0, 2 * np.pi, 0)]
            rows += [[0, 0, 0, x, 0] for x in (-0.5, 1.6, -0.5)]
            q = np.array(rows, dtype=float)
        paths.append(AxisPath(m.axis_names, q, part.target))
    return calibrate_recordings([simulated(paths, 11)[0]])


def test_circles_alone_do_not_show_the_angular_positioning():
    result = circles_only(False)
    assert {'ECC', 'EAA'} <= set(result.not_identifiable)
    seen = {'EXC', 'EYC', 'EZC', 'EAC', 'EBC', 'X0C', 'Y0C', 'A0C'}
    assert not seen & set(result.not_identifiable)
    assert not result.tables.motions['ECC'].value.any()
    assert 'together in both senses' in result.advice['ECC']


def test_circles_at_a_tilted_table_leave_the_zero_of_the_tilting_axis_open():
    result = circles_only(True)
    assert {'ECC', 'EAA', 'A0C'} <= set(result.not_identifiable)
    assert 'EXC' not in result.not_identifiable
    assert not result.tables.location['A0C'].identifiable


def test_path_that_shows_little_ends_with_what_it_shows():
    q = np.zeros((3, 5))
    q[:, 3] = (-0.3, 0.3, -0.3)
    parts = [AxisPath(machine().axis_names, q, f'nest-{k}') for k in (1, 2, 3)]
    result = calibrate_recordings([simulated(parts)[0]])
    assert {'EXX', 'EAA', 'EXC', 'A0C', 'Y0A'} <= set(result.not_identifiable)
    assert not {'EYA', 'EZA', 'EBA', 'ECA'} & set(result.not_identifiable)
    assert set(result.advice) == set(result.not_identifiable) and all(result.advice.values())
    (text,) = [w for w in result.warnings if w.startswith('driven range: ')]
    assert 'X over 0 of' in text and 'A over 28 of 120 deg' in text


def test_bad_samples_of_a_part_are_left_out_and_said():
    samples = recorded().samples
    xyz, part = samples.xyz.copy(), split_parts(samples, machine(), recorded().parts)[0]
    middle = (part.first + part.last) // 2
    xyz[middle : middle + 200] += 3e-5  # a beam that was disturbed for longer
    spoiled = replace(recorded(), samples=replace(samples, xyz=xyz), name='spoiled')
    result = calibrate_recordings([spoiled])
    (text,) = [w for w in result.warnings if w.startswith('left out: ')]
    assert 'spoiled: ' in text and 'in whole pieces of the path' in text
    assert not result.failed_gates
    with pytest.raises(InputError, match='of its samples are those of'):
        calibrate_recordings([recorded(), recorded()])


def test_axis_that_turns_the_other_way_is_named_with_the_sign_that_fits():
    m = machine()
    axes = {**m.axes, 'C': replace(m.axes['C'], direction=(0.0, 0.0, -1.0))}
    recording = replace(recorded(), machine=replace(m, axes=axes))
    words = r'fits where C turns the other way; write C: direction: \[0.0, 0.0, 1.0\]'
    with pytest.raises(InputError, match=words):
        calibrate_recordings([recording])


def test_centre_and_a_length_that_are_wrong_fail_the_gate():
    m = machine()
    axes = {**m.axes, 'A': replace(m.axes['A'], centre=(0.0, 0.0, 0.023))}
    x, y, z = m.targets['long'].place
    long = replace(m.targets['long'], place=(x, y, z + 3e-5), u=0.0)
    wrong = replace(m, axes=axes, stated_targets={**m.stated_targets, 'long': long})
    result = calibrate_recordings([replace(recorded(), machine=wrong)])
    assert result.verdicts.exit_code == 4
    length, centre = result.failed_gates[0], result.failed_gates[-1]
    assert "target 'long'" in length and 'u: 3e-05' in length
    assert 'axes: A: centre' in centre
    assert float(centre.split(', ')[-1].split(']')[0]) == pytest.approx(0.02, abs=3e-5)


def test_places_off_by_ten_millimetres_still_converge():
    m = machine()
    targets = {
        n: replace(t, place=(t.place[0] + 0.006, t.place[1] - 0.006, t.place[2] + 0.005))
        if t.link == 'w'
        else t
        for n, t in m.stated_targets.items()
    }
    off = replace(m, stated_targets=targets)
    found = match(recorded().samples, off, recorded().parts)
    for name in ('nest-1', 'nest-2', 'nest-3'):
        assert np.abs(found.places[name] - calibrated().targets[name].place).max() < 1e-4


def test_command_line_from_simulation_to_prediction(tmp_path, capsys):
    folder, out = tmp_path / 'bag', tmp_path / 'out'
    yaml = str(BAG / 'machine.yaml')
    options = ['--rate', '25', '--feed', '9000', {'corner_dwell': 0.1}, '--seed', '3']
    assert run('simulate', '--machine', yaml, '--out', str(folder), *options) == 0
    assert run('calibrate', str(folder), '--machine', yaml, '--out', str(out)) == 0
    data = json.loads((out / 'error_tables.json').read_text())
    assert data['schema'] == 'otf-error-tables/2'
    assert data['motions']['ECC']['position_unit'] == 'rad'
    assert set(data['location']) == set(machine().location)
    assert data['targets']['nest-1']['u'][0] > 0 and 'gauge' in data
    points, errors = tmp_path / 'p.csv', tmp_path / 'e.csv'
    points.write_text('x,y,z,a,c\n0,0,0.1,0.5,3.0\n0.05,0.02,0.2,-0.3,9.0\n')
    words = ['--tables', str(out / 'error_tables.json'), '--points', str(points)]
    assert run('predict', *words, '--out', str(errors)) == 0
    rows = np.genfromtxt(errors, delimiter=',', names=True)
    assert list(rows.dtype.names[:5]) == ['x', 'y', 'z', 'a', 'c']
    assert rows['inside'].tolist() == [1.0, 1.0] and np.all(rows['u_dx'] > 0)
    assert run('info', str(out / 'error_tables.json')) == 0
    assert 'small-trunnion' in capsys.readouterr().out
    points.write_text('x,y,z\n0,0,0.1\n')
    assert run('predict', *words, '--out', str(errors), '--overwrite') == 2
    assert 'expected x,y,z,a,c' in capsys.readouterr().err
    page = (out / 'report.html').read_text()
    assert 'mean error over A and C' in page
    assert 'average line of C' in page and 'Radial motion of C' in page


def test_reversal_that_changes_along_a_rotary_axis_is_found_as_a_table():
    changing = {'ECC_1': 4e-5, 'ECC_2': -3e-5, 'order': 3.0, 'held': 1.0}
    effects = [
        AppliedEffect(EVERY['direction_dependent_tables'], changing),
        AppliedEffect(EVERY['backlash'], {'B_C': -4e-5, 'held': 1.0}),
    ]
    recording, _ = simulated(parts(), effects=effects)
    reversal = calibrate_recordings([recording]).reversal
    assert reversal.model == 'tables' and reversal.evidence['decided_by'] == 'held-out lines'
    assert list(reversal.motions) == ['ECC']
    table = reversal.motions['ECC']
    true = -4e-5 + 4e-5 * np.cos(table.position) - 3e-5 * np.sin(table.position)
    assert np.all(np.abs(table.value - true) < 3.0 * table.u) and table.u.max() < 6e-6


def test_lag_of_an_axis_is_found_and_leaves_the_tables_alone():
    plain, run = simulated(parts())
    lag = AppliedEffect(EVERY['servo_mismatch'], {'T_C': 2e-4})
    recording, _ = simulated(parts(), effects=[lag])
    without, result = (calibrate_recordings([r]) for r in (plain, recording))
    assert not without.reversal.motions and not without.lags
    # driven at one feed the axis might as well reverse: the other one is named beside it
    found = result.reversal
    assert [*found.motions, *(one.axis for one in result.lags)] in (['ECC'], ['C'])
    assert {'ECC_0', 'lag C'} & set(found.evidence['indistinguishable_from'].split(', '))
    for one in result.lags:
        assert one.value == pytest.approx(2e-4, abs=3 * one.u) and one.u < 1e-5
    q = evenly_spread(machine().lower, machine().upper, 400)
    assert left(result.tables, run.truth, q) < 1.1 * left(without.tables, run.truth, q)
    for motion, table in result.tables.motions.items():
        if motion.axis not in machine().rotary_names:
            continue  # driven alone: another start of the same search moves EYZ with EAZ by 2 u
        change = np.abs(table.value - without.tables.motions[motion].value)
        small = 5e-7 if motion.unit == 'm' else 2e-6
        # the roughness that is most likely may be another one: within its share of u
        assert np.all(change < np.maximum(small, 3.0 * table.u_run)), motion


def with_tracker_moved(part, size):
    """The recorded run with the tracker moved before a part."""
    samples = recorded().samples
    first = split_parts(samples, machine(), recorded().parts)[part].first
    xyz = samples.xyz.copy()
    xyz[first:] += size * (np.array([0.6, -0.3, 0.5]) + np.cross([0.7, -1.0, 0.3], xyz[first:]))
    return replace(recorded(), samples=replace(samples, xyz=xyz))


def test_tracker_that_moved_a_little_between_parts_is_named():
    moved = with_tracker_moved(1, 6e-5)
    (text,) = calibrate_recordings([moved]).failed_gates
    assert 'from part 2 on' in text and 'the tracker has moved' in text


def test_step_of_the_tracker_that_keeps_a_solution_from_converging_is_named():
    with pytest.raises(InputError, match=r'from part 4 on .* the tracker has moved'):
        calibrate_recordings([with_tracker_moved(3, 2.5e-4)])


def test_facings_of_a_reflector_are_one_nest_to_the_solution():
    data = machine().to_dict()
    for own in data['targets'].values():
        own |= {'facings': 5, 'u_facing': 2e-6} if own['link'] == 'w' else {}
    m = machine_from_dict(data)
    chains = facing_chains(m, default_tracker_place(m))
    paths = [p for p in parts() if m.targets[p.target].link == 't']
    paths += [p.path for p in parts_of(m, chains, PlannerConfig())]
    recording, run = simulated(paths, 21, m, tracker_place=default_tracker_place(m))
    result = calibrate_recordings([recording])
    assert not result.failed_gates
    assert left(result.tables, run.truth, evenly_spread(m.lower, m.upper, 400)) < 0.1
    for nest in (n for n, t in m.targets.items() if t.nest == n):
        places = [result.targets[n].place for n in facing_names(nest, 5)]
        apart = [run.places[n] for n in facing_names(nest, 5)]
        found, true = (np.array(v) - np.mean(v, axis=0) for v in (places, apart))
        assert np.all(np.abs(found - true) < 6e-6)


def test_reflector_that_was_reseated_is_named():
    tool, _, nest, *_ = parts()
    recording, run = simulated([tool, nest, nest])
    samples = recording.samples
    last = int(np.flatnonzero(np.diff(samples.stamp_ns) > 1.9e9)[-1]) + 1
    xyz = samples.xyz.copy()
    moved = {}
    for shift in (0.0, 6e-5):
        place = run.places['nest-1'] + shift
        sight = Sight(machine(), 'b', 'w', place)
        time = samples.time[last:] - samples.time[last]
        q = run.drives[-1].at(time)
        moved[shift] = sight.nominal(q) @ run.pose.rotation
    xyz[last:] += moved[6e-5] - moved[0.0]
    other = replace(recording, samples=replace(samples, xyz=xyz))
    result = calibrate_recordings([other])
    assert any("target 'nest-1': in part 3 it lies 10" in w for w in result.failed_gates)
    good = calibrate_recordings([recording])
    assert not good.failed_gates


def test_effect_that_a_diagnosis_finds_is_taken_off():
    drift = AppliedEffect(EVERY['thermal_structure_drift'], {'D_X': 2e-5, 'tau': 60.0})
    recording, run = simulated(parts(), effects=[drift])
    result = otf_core.calibrate(recording, effects='auto')
    assert [one.effect for one in result.effects] == ['thermal_structure_drift']
    q = evenly_spread(machine().lower, machine().upper, 400)
    plain = left(result.plain.tables, run.truth, q)
    assert left(result.tables, run.truth, q) < 0.2 * plain

# SPDX-License-Identifier: Apache-2.0
"""Whole calibrations of machines with rotary axes: recorded, simulated, with contradictions."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rotary_cells import BAG, machine, parts, recorded, simulated

import otf_core
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import PlannerConfig
from otf_core.effects import EVERY, AppliedEffect
from otf_core.errors import InputError
from otf_core.model.chain import Sight, displacement
from otf_core.model.evaluation import evenly_spread
from otf_core.model.machine import facing_names, machine_from_dict
from otf_core.model.sections import DeclaredUncertainty
from otf_core.planning.chains import parts_of
from otf_core.planning.facings import facing_chains
from otf_core.planning.line_of_sight import default_tracker_place
from otf_core.prediction.uncertainty import prediction_uncertainty
from otf_core.solving.tabulate import remove_rigid_motions
from otf_core.tracking.curve_matching import split_parts


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


def test_axis_that_turns_the_other_way_is_named_with_the_sign_that_fits():
    m = machine()
    axes = {**m.axes, 'C': replace(m.axes['C'], direction=(0.0, 0.0, -1.0))}
    recording = replace(recorded(), machine=replace(m, axes=axes))
    words = r'fits where C turns the other way; write C: direction: \[0.0, 0.0, 1.0\]'
    with pytest.raises(InputError, match=words):
        calibrate_recordings([recording])


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
    assert 'part 2' in text and 'tracker' in text


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

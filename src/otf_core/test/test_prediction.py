# SPDX-License-Identifier: Apache-2.0
"""Predictions: inside and outside, for another target, and points that are refused.

The files are written by hand here; what they must give follows from the model of the contract.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from core_cells import error_of, some_machine, written_tables, zero_tables

from otf_core.model.evaluation import lattice
from otf_core.model.motions import MOTIONS
from otf_core.prediction.calibration_document import tables_to_dict
from otf_core.prediction.predict import predict
from otf_core.solving.tabulate import USUAL_ANGLE, unseen_sizes


def blind_to(tables, *names):
    """Tables in which these motions were not seen."""
    motions = dict(tables.motions)
    for name in names:
        motions[name] = replace(motions[name], identifiable=False)
    return replace(tables, motions=motions)


def known_to(tables, u):
    """Tables with the same standard uncertainty at every node."""
    motions = {m: replace(t, u=np.full(len(t.position), u)) for m, t in tables.motions.items()}
    return replace(tables, motions=motions)


# ---------------------------------------------------------------- beyond the ends


def test_outside_the_driven_volume_no_u_is_stated(tmp_path):
    tables = known_to(zero_tables(some_machine()), 1e-7)
    q = np.array([[0.3, 0.1, -0.1], [0.35, 0.1, -0.1], [-0.1, 0.1, -0.1], [0.2, 0.1, -0.1]])
    found = predict(written_tables(tmp_path, tables), q)
    assert found.inside.tolist() == [True, False, False, True]
    assert np.isfinite(found.u).all(axis=1).tolist() == found.inside.tolist()
    assert np.isfinite(found.error).all()
    assert any('2 of 4' in n for n in found.notes)
    assert 'no u, as all lie outside' in predict(written_tables(tmp_path, tables), q[1:2]).summary


def test_rotations_that_are_not_seen_are_as_large_as_those_that_are():
    tables = zero_tables(some_machine())
    seen = tuple(m for m in MOTIONS if m not in ('EAZ', 'ECX'))
    motions = {m: replace(t, value=t.value + 3e-5) for m, t in tables.motions.items()}
    sizes = unseen_sizes(replace(tables, motions=motions), seen)
    assert sizes == {'EAZ': pytest.approx(3e-5), 'ECX': pytest.approx(3e-5)}
    assert set(unseen_sizes(tables, ()).values()) == {USUAL_ANGLE}


# ---------------------------------------------------------------- rotations not seen


def absorbed(tables, name, value, levers):
    """Tables of a machine with one more rotation that is held by translations at its levers."""
    unit = np.eye(3)['ABC'.index(name[1])]
    moved = np.cross(unit, levers)
    motions = dict(tables.motions)
    for k, direction in enumerate('XYZ'):
        motion = f'E{direction}{name[2]}'
        motions[motion] = replace(motions[motion], value=motions[motion].value + value * moved[k])
    return replace(tables, motions=motions)


def turned(tables, name, value):
    motions = dict(tables.motions)
    motions[name] = replace(motions[name], value=motions[name].value + value)
    return replace(tables, motions=motions)


def test_an_unseen_rotation_is_in_u_for_another_tool_and_only_there(tmp_path):
    """Machines with rotation ECZ, tables without: right at T, off at T' by what u says."""
    rng, sd = np.random.default_rng(2), 3e-5
    base = zero_tables(some_machine(), nodes=4)
    tables = blind_to(base, 'ECZ')
    q = lattice(base.machine, 3)
    longer = np.array([0.1, 0.05, -0.25])
    file = written_tables(tmp_path, tables, prior={'ECZ': {'sd': sd}})
    own, other = predict(file, q), predict(file, q, longer)
    assert np.all(own.u == 0)
    assert not any('not seen' in n for n in own.notes)
    assert any('ECZ were not determined' in n and 'by their prior' in n for n in other.notes)
    off = []
    for _ in range(200):
        value = sd * rng.standard_normal(4)
        truth = turned(base, 'ECZ', value)
        seen = absorbed(base, 'ECZ', value, base.machine.target_offset)
        here = error_of(truth, q[:3]) - error_of(seen, q[:3])
        np.testing.assert_allclose(here, 0.0, atol=1e-18)
        at_longer = replace(base.machine, target_offset=longer)
        there = [error_of(replace(t, machine=at_longer), q[:1])[0] for t in (truth, seen)]
        off.append(there[0] - there[1])
    np.testing.assert_allclose(np.std(off, axis=0), other.u[0], rtol=0.2, atol=1e-15)
    np.testing.assert_allclose(other.u, np.tile([0.08 * sd, 0.08 * sd, 0.0], (27, 1)), rtol=1e-9)


def test_a_seen_rotation_acts_through_the_offset_that_is_asked_for(tmp_path):
    tables = turned(zero_tables(some_machine()), 'EAZ', 1e-5)
    q = np.array([[0.1, 0.2, -0.1]])
    found = predict(written_tables(tmp_path, tables), q, np.array([0.0, 0.1, -0.3]))
    np.testing.assert_allclose(found.error[0], 1e-5 * np.array([0.0, 0.3, 0.1]), rtol=1e-12)


# ---------------------------------------------------------------- what a file does not say


def without(tmp_path, squareness, *motions):
    """A file of exact tables that says so much of squareness, and no u of some motions."""
    file = written_tables(tmp_path, known_to(zero_tables(some_machine()), 1e-7))
    data = json.loads(file.read_text())
    data['squareness'] = squareness
    for name in motions:
        del data['motions'][name]['u']
    file.write_text(json.dumps(data))
    return file


def test_what_a_file_does_not_say_is_zero_and_named(tmp_path):
    file = without(tmp_path, {'C0Y': {'value': 1e-5}, 'B0Z': {}}, 'EXX', 'EBY')
    found = predict(file, np.array([[0.2, 0.1, -0.1]]))
    np.testing.assert_allclose(found.error, [[-1e-6, 0.0, 0.0]], atol=1e-18)
    assert 'the tables do not contain B0Z, A0Z: taken as zero' in found.notes
    assert any(note.startswith('the tables hold no u of C0Y, EXX, EBY: ') for note in found.notes)


# ---------------------------------------------------------------- points


def test_older_files_mean_noise_misfit_and_what_was_declared_by_u(tmp_path):
    data = tables_to_dict(known_to(zero_tables(some_machine()), 1e-7))
    del data['systematic']
    data['headline'] = {'unit': 'm', 'expected_after_compensation': {'U': {'mean': 1e-6}}}
    (tmp_path / 'tables.json').write_text(json.dumps(data))
    found = predict(tmp_path / 'tables.json', np.array([[0.1, 0.1, -0.1]]))
    assert 'the contributions in the tables, which their file does not state' in found.summary
    assert found.summary.startswith('1 point: ')
    assert any('older file: u holds noise, misfit and what was declared' in n for n in found.notes)
    np.testing.assert_array_equal(found.u, found.u_run)

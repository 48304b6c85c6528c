# SPDX-License-Identifier: Apache-2.0
"""Stops of a machine with a rotary table, solved by the core and by dense least squares.

See certified_rotary/README.md. Rows, gauge and tables are those of ``calibrate``; weights and what
is assumed before any data are given, since a calibration searches for them.
"""

import ast
import json
from dataclasses import replace

import numpy as np
import pytest
from certified_rotary import dense, make_stops
from certified_rotary.exact_chain import HERE, MACHINE, NODES

from otf_core.model.axis_path import AxisPath
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import machine_from_dict
from otf_core.noise.noise_model import NoiseModel
from otf_core.pieces.pieces import Pieces
from otf_core.pieces.runs import Observed
from otf_core.solving.joint import place_equations
from otf_core.solving.normal import normal_equations
from otf_core.solving.solution import solve
from otf_core.solving.system import build_system
from otf_core.solving.tabulate import table_rows
from otf_core.solving.unknowns import layout, linear_bases, place_block, pose_block
from otf_core.solving.whitener import Whitener
from otf_core.tracking.curve_matching import nominal_places

EXPECTED = json.loads((HERE / 'expected.json').read_text(encoding='utf-8'))
TRUTH = json.loads((HERE / 'truth.json').read_text(encoding='utf-8'))
LIMIT = 1e-3
DIGITS = 1e-8
"""Relative, of the largest value: both invert matrices of a condition of 1e8."""


def stops(machine, name):
    """Run of the stops and the inverse of the standard deviations of their rows."""
    targets, q, xyz = dense.read_stops(name)
    order = list(dict.fromkeys(targets))
    parts = [AxisPath(machine.axis_names, q[[t == n for t in targets]], n) for n in order]
    count, zero = len(q), np.zeros((len(q), 3))
    number = np.array([order.index(t) for t in targets])
    places = nominal_places(machine)
    start = RigidTransform(*(np.array(TRUTH['start'][k]) for k in ('rotation', 'translation')))
    pieces = Pieces(
        q=q, step=np.zeros_like(q), spread=np.zeros(count), xyz=xyz, nominal=zero,
        direction=zero, origin=zero, part=number, leg=np.arange(count),
        stretch=np.arange(count), side=np.zeros_like(q), rate=np.zeros_like(q),
        speed=np.zeros(count), count=np.full(count, dense.SAMPLES), time=np.arange(count) * 2.0,
        duration=np.ones(count), method='standstill',
    )  # fmt: skip
    targets, noise = tuple(p.target for p in parts), NoiseModel.from_spec(machine.tracker)
    run = Observed(
        machine=machine, pieces=pieces, pose=start, noise=noise, name=name, targets=targets,
        places=places, base=places,
    )  # fmt: skip
    size = np.linalg.norm(xyz, axis=1)
    spec = machine.tracker
    sd = np.stack([np.full(count, spec.u_range), spec.u_angle * size, spec.u_angle * size])
    return run, sd / np.sqrt(dense.SAMPLES)


def nominal_points(machine, run, places):
    """Nominal points of the pieces at places of the targets."""
    points = np.zeros((len(run.pieces), 3))
    for name, own in run.by_target().items():
        points[own] = replace(run, places=places).sight(name).nominal(run.pieces.q[own])
    return points


def expected_before(unknowns):
    """Precision of the free unknowns that the reference assumes, 1 / (m, rad)^2."""
    full = np.zeros(unknowns.full)
    for name, block in unknowns.blocks.items():
        if ' ' not in name:
            length = name[1 if name[0] == 'E' else 0] in 'XYZ'
            full[block] = dense.SIZE['translation' if length else 'rotation'] ** -2.0
    gauge = unknowns.gauge.toarray()
    return gauge.T @ (full[:, None] * gauge)


def solved(name):
    """Values and uncertainties by name as the tables hold them, and places."""
    machine = machine_from_dict(MACHINE)
    run, sd = stops(machine, name)
    nodes = {a: NODES[a] for a in machine.axis_names}
    unknowns = layout(linear_bases(machine, nodes), targets=dense.NESTS)
    prior = expected_before(unknowns)
    pose, places = run.pose, dict(run.places)
    bounds = [(k, k + 1) for k in range(len(run.pieces))]
    whitener = Whitener.from_factors(bounds, [sd[:, k, None, None] for k in range(len(bounds))])
    for _ in range(10):
        pieces = replace(run.pieces, nominal=nominal_points(machine, run, places))
        now = replace(run, pieces=pieces, pose=pose, places=places, base=dict(places))
        normal = normal_equations(build_system(now, unknowns), unknowns, whitener)
        normal = normal + place_equations(machine, unknowns, places)
        accepted = tuple(n for n, s in unknowns.free_blocks.items() if s.stop > s.start)
        solution = solve(normal, unknowns, LIMIT, accepted, prior)
        step = solution.value[unknowns.blocks[pose_block(0)]]
        pose = pose.moved_by(step[:3], step[3:])
        for nest in dense.NESTS:
            places[nest] = places[nest] + solution.value[unknowns.blocks[place_block(nest)]]
    rows = table_rows(machine, unknowns, nodes)
    value = rows @ solution.value
    u = np.sqrt(np.maximum(np.diag(rows @ solution.covariance @ rows.T), 0.0))
    names = [(n, 1) for n in machine.scalars]
    names += [(str(m), len(nodes[m.axis])) for m in machine.motions]
    ends = np.cumsum([size for _, size in names])
    cut = lambda v: dict(zip((n for n, _ in names), np.split(v, ends[:-1]), strict=True))  # noqa: E731
    return cut(value), cut(u), places


@pytest.fixture(scope='module', params=['stops', 'exact'])
def both(request):
    return (*solved(f'{request.param}.csv'), EXPECTED[request.param])


def test_core_and_dense_least_squares_agree_digit_by_digit(both):
    value, u, places, expected = both
    assert set(expected) == set(value) | set(dense.NESTS)
    for unit in ('XYZ', 'ABC'):
        names = [n for n in value if n[1 if n[0] == 'E' else 0] in unit]
        for mine, key in ((value, 'value'), (u, 'u')):
            found, wanted = (
                np.concatenate(own)
                for own in ([mine[n] for n in names], [expected[n][key] for n in names])
            )
            np.testing.assert_allclose(found, wanted, rtol=0, atol=DIGITS * np.abs(wanted).max())
    for nest in dense.NESTS:
        np.testing.assert_allclose(places[nest], expected[nest]['value'], rtol=0, atol=1e-12)


def test_without_noise_the_true_errors_come_out():
    truth = np.concatenate([np.atleast_1d(TRUTH[n]) for n in dict(dense.NAMES)])
    wanted = dense.line_of_c() @ truth
    found = np.concatenate([EXPECTED['exact'][n]['value'] for n in dict(dense.NAMES)])
    # errors of the second order: a rotation of 1e-4 turns a displacement of 1e-4 m
    assert np.abs(found - wanted).max() < 1e-7


def test_uncertainties_cover_the_true_errors():
    truth = np.concatenate([np.atleast_1d(TRUTH[n]) for n in dict(dense.NAMES)])
    wanted = dense.line_of_c() @ truth
    found, u = (
        np.concatenate([EXPECTED['stops'][n][k] for n in dict(dense.NAMES)])
        for k in ('value', 'u')
    )
    seen = u > 1e-12
    ratio = (found - wanted)[seen] / u[seen]
    assert 0.7 < np.sqrt(np.mean(ratio**2)) < 1.3


def test_expected_values_are_those_that_the_reference_computes():
    for name in ('stops', 'exact'):
        again = dense.tables(f'{name}.csv', TRUTH['start'])
        for key, own in EXPECTED[name].items():
            for what, wanted in own.items():
                limit = 1e-9 * max(np.abs(wanted).max(), 1e-6)
                np.testing.assert_allclose(again[key][what], wanted, rtol=0, atol=limit)


def test_stops_are_those_that_their_maker_draws(monkeypatch, tmp_path):
    monkeypatch.setattr(make_stops, 'HERE', tmp_path)
    make_stops.main()
    for name in ('stops.csv', 'exact.csv'):
        (_, *drawn), (_, *stored) = (
            [row.split(',') for row in (place / name).read_text(encoding='utf-8').splitlines()]
            for place in (tmp_path, HERE)
        )
        assert [row[0] for row in drawn] == [row[0] for row in stored]
        numbers = (np.array([row[1:] for row in rows], float) for rows in (drawn, stored))
        np.testing.assert_allclose(*numbers, rtol=0, atol=3e-12)  # written to 1e-12
    drawn = json.loads((tmp_path / 'truth.json').read_text(encoding='utf-8'))
    assert set(drawn) == set(TRUTH)
    for name in set(TRUTH) - {'start'}:
        np.testing.assert_allclose(drawn[name], TRUTH[name], rtol=1e-12, atol=1e-18)
    for part, wanted in TRUTH['start'].items():
        np.testing.assert_allclose(drawn['start'][part], wanted, rtol=0, atol=1e-13)


def test_the_reference_imports_numpy_and_nothing_of_the_core():
    for file in HERE.glob('*.py'):
        tree = ast.parse(file.read_text(encoding='utf-8'))
        names = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
        names |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        assert {n.split('.')[0] for n in names} <= {'certified_rotary', 'numpy', 'json', 'pathlib'}

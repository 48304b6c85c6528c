# SPDX-License-Identifier: Apache-2.0
"""A small run whose tables, uncertainties and gap are computed outside, digit by digit.

See certified/README.md. The functions are those of ``calibrate`` and ``diagnose``; noise and
roughness are given instead of searched for.
"""

import ast
import json
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from certified import dense_least_squares as dense
from certified import make_run
from certified.measured_rows import HERE, pieces_of, read_run, read_samples

from otf_core.calibration.assembly import assemble
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.gap_sizes import gap_um, plain_residuals
from otf_core.diagnosis.engine.residual_rows import build_rows
from otf_core.model.machine import machine_from_dict
from otf_core.model.motions import MOTIONS
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.tables import with_uncertainty
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.prediction.calibration_document import load_tables
from otf_core.prediction.predict import predict
from otf_core.reports.calibration import write_calibration
from otf_core.solving import roughness
from otf_core.solving.joint import Start, solve_jointly
from otf_core.solving.model_choice import Choice, ReversalSolution
from otf_core.solving.unknowns import layout, linear_bases, smooth_bases

RUN = read_run()
CONFIG = CalibrationConfig(**RUN['config'])
EXPECTED = json.loads((HERE / 'expected.json').read_text(encoding='utf-8'))
SEEN = [m for m in MOTIONS if m not in RUN['not_identifiable']]
DIGITS = 1e-9
"""Relative; of the largest value of each array."""

ROUNDING = 1e-18
"""m or rad; zeros come out smaller than this."""


def same(found, wanted, digits=DIGITS):
    """Assert equality up to a share of the largest value; what is nothing but rounding is zero."""
    found, wanted = np.asarray(found, dtype=float), np.asarray(wanted, dtype=float)
    limit = max(digits * np.abs(wanted).max(), ROUNDING)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=limit)


def all_the_same(found, wanted, digits=DIGITS):
    """Assert the same of nested data."""
    if isinstance(wanted, dict):
        assert found.keys() == wanted.keys()
        for key in wanted:
            all_the_same(found[key], wanted[key], digits)
    elif isinstance(wanted, str):
        assert found == wanted
    else:
        same(found, wanted, digits)


def recording(name):
    stamp_ns, _, xyz = read_samples(name)
    machine = machine_from_dict(RUN['machine'], 'run.json')
    return Recording(Samples(stamp_ns, xyz), NominalPath(np.array(RUN['corners'])), machine)


def logarithms():
    """The given roughness as the core counts it: in units of the limit."""
    unit = [CONFIG.unidentifiable_above**2, 1.0, CONFIG.unidentifiable_above**2]
    return {m: np.log(np.divide(v, unit)) for m, v in dense.given_roughness(RUN).items()}


def solved(run, bases):
    """Joint solution with the given roughness."""
    names = layout(bases).free_blocks
    start = Start(logarithms(), tuple(n for n in names if n not in RUN['not_identifiable']))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(roughness, 'MAX_STEPS', 0)
        return solve_jointly([run], layout(bases), CONFIG, lambda stage, fraction: None, start)


def with_given_noise(run):
    given = RUN['given']['noise']
    specified = RUN['given']['specified']
    white, slow = (given[k] / specified[k] for k in ('white', 'slow'))
    misfit = given['misfit_piece'] ** 2, given['misfit_line'] ** 2
    return replace(
        run,
        fitted=np.log(
            [white, slow, given['correlation_time'] / specified['correlation_time'], *misfit]
        ),
    )


@pytest.fixture(scope='module')
def prepared():
    """The run as calibrate prepares it, and its table nodes."""
    runs, nodes = prepare_runs([recording('samples.csv')], CONFIG)
    return SimpleNamespace(run=runs[0], nodes=nodes)


@pytest.fixture(scope='module', params=['straight', 'smooth'])
def calibration(request, prepared):
    """Result of the core for both kinds of functions, and what is expected."""
    bases = {'straight': linear_bases, 'smooth': smooth_bases}[request.param](
        prepared.run.machine, prepared.nodes
    )
    run = with_given_noise(prepared.run)
    done = solved(run, bases)
    done = ReversalSolution([run], done, Choice('none', False, {}), [run], ([run], done))
    result = assemble(done, CONFIG)
    # tables for use inside are straight between 8 places in every interval between knots
    digits = {'straight': DIGITS, 'smooth': 2e-6}[request.param]
    return SimpleNamespace(result=result, expected=EXPECTED[request.param], digits=digits)


def test_the_reference_imports_numpy_and_nothing_of_the_core():
    for file in HERE.glob('*.py'):
        tree = ast.parse(file.read_text(encoding='utf-8'))
        names = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
        names |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        others = {n.split('.')[0] for n in names} - {'certified', 'numpy'}
        assert others <= {'dataclasses', 'functools', 'itertools', 'json', 'pathlib', 'types'}


def test_expected_values_are_those_that_the_reference_computes():
    all_the_same(dense.plain(dense.expected(RUN)), EXPECTED)


def test_run_is_the_one_that_its_maker_draws(monkeypatch, tmp_path):
    monkeypatch.setattr(make_run, 'HERE', tmp_path)
    make_run.main()
    assert read_run(tmp_path) == RUN
    for name in ('samples.csv', 'twin.csv'):
        drawn, stored = (
            np.loadtxt(place / name, delimiter=',', skiprows=1) for place in (tmp_path, HERE)
        )
        np.testing.assert_array_equal(drawn[:, :2], stored[:, :2])
        np.testing.assert_allclose(drawn, stored, rtol=0, atol=1.1e-9)  # rounded to 1 nm


def test_samples_are_averaged_over_the_same_pieces(prepared):
    pieces, _ = pieces_of(RUN, 'samples.csv')
    found = prepared.run.pieces
    for name in ('leg', 'count'):
        np.testing.assert_array_equal(getattr(found, name), getattr(pieces, name))
    for name in ('xyz', 'origin', 'direction', 'time', 'duration'):
        same(getattr(found, name), getattr(pieces, name), 1e-14)
    same(found.spread, pieces.spread, 1e-7)  # along lines in the pose of the rough alignment


def as_declared(result):
    """Covariance without typical values of what is not declared."""
    change = result.covariance_change
    return result.covariance_run if change is None else change


def test_tables_are_the_expected_ones(calibration):
    expected = calibration.expected
    tables = with_uncertainty(calibration.result.tables, as_declared(calibration.result))
    assert [m for m in MOTIONS if tables.motions[m].identifiable] == list(expected['motions'])
    for name, motion in expected['motions'].items():
        same(tables.motions[name].position, motion['position'], 1e-15)
        same(tables.motions[name].value, motion['value'], calibration.digits)
        same(tables.motions[name].u, motion['u'], calibration.digits)
    for name, entry in expected['squareness'].items():
        same(tables.squareness[name].value, entry['value'], calibration.digits)
        same(tables.squareness[name].u, entry['u'], calibration.digits)


def test_every_source_of_uncertainty_is_the_expected_one(calibration):
    budget = calibration.result.budget
    ends = np.cumsum([0, 3] + [len(calibration.result.tables.motions[m].u) for m in MOTIONS])
    seen = [True, *(m in SEEN for m in MOTIONS)]
    kept = np.concatenate(
        [np.full(b - a, s) for (a, b), s in zip(pairwise(ends), seen, strict=True)]
    )
    found = dict(zip(budget.names, np.sqrt(budget.variances())[:, kept], strict=True))
    u = np.abs(calibration.expected['u_by_source']['noise']).max()
    for name, wanted in calibration.expected['u_by_source'].items():
        np.testing.assert_allclose(found[name], wanted, rtol=0, atol=calibration.digits * u)


def test_alignment_and_fit_are_the_expected_ones(calibration):
    result, expected = calibration.result, calibration.expected
    same(result.T_machine_tracker.rotation, expected['alignment']['rotation'], 1e-10)
    same(result.T_machine_tracker.translation, expected['alignment']['translation'], 1e-10)
    for name, wanted in expected['fit'].items():
        assert getattr(result.fit, name) == pytest.approx(wanted, rel=calibration.digits), name


@pytest.mark.parametrize('calibration', ['straight'], indirect=True)
def test_predictions_from_the_written_file_are_the_expected_ones(calibration, tmp_path):
    write_calibration(calibration.result, tmp_path)
    file = load_tables(tmp_path / 'error_tables.json')
    file = replace(file, covariance=file.covariance_change or file.covariance_run)
    found = predict(file, np.array(dense.PLACES))
    same(found.error, calibration.expected['predicted']['error'])
    same(found.u, calibration.expected['predicted']['u'])


def test_gap_is_the_expected_one(prepared):
    twin, _ = prepare_runs([recording('twin.csv')], CONFIG)
    residuals = []
    for run in (prepared.run, *twin):
        rows = build_rows([run], solved(run, linear_bases(run.machine, prepared.nodes)), 1e-4)
        residuals.append(plain_residuals(rows).rms_um)
    expected = EXPECTED['gap']
    same(residuals, [expected['measured_um'], expected['simulated_um']])
    same(gap_um(*residuals), expected['before_um'])

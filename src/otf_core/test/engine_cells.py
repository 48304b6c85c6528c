# SPDX-License-Identifier: Apache-2.0
"""Rows of a small cell for the tests of the engine of the diagnosis, and what is put into them."""

import functools
from dataclasses import dataclass, replace

import numpy as np
from core_cells import record, small_plan, some_machine
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.effect_products import ShapeProducts
from otf_core.diagnosis.engine.evidence import Option
from otf_core.diagnosis.engine.residual_rows import build_rows
from otf_core.diagnosis.engine.search import Cause, tried_effects
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.sim.cell import random_tables
from otf_core.solving.joint import solve_jointly
from otf_core.solving.unknowns import layout, linear_bases

LIMIT = CalibrationConfig().unidentifiable_above


@functools.cache
def solved_rows():
    """Rows of two runs of one machine, 900 pieces each, the second with a longer target."""
    machine = some_machine(pitch=0.1)
    plan = small_plan(machine)
    truth = random_tables(machine, 2e-5, np.random.default_rng(3))
    recordings = []
    for seed, offset in enumerate(machine.target_offset + np.array([[0, 0, 0], [0, 0, -0.1]])):
        own = replace(machine, target_offset=offset)
        driven = record(own, plan, rate=50.0)
        samples = driven.measured(replace(truth, machine=own), seed=seed)
        recordings.append(Recording(samples, plan.path, own))
    config = CalibrationConfig(piece_length=0.024)
    runs, nodes = prepare_runs(recordings, config)
    unknowns = layout(linear_bases(machine, nodes), 2)
    done = solve_jointly(runs, unknowns, config, lambda stage, fraction: None)
    return build_rows(runs, done, LIMIT)


def coloured(rows, white):
    """Plain deviations (r,) whose whitened ones are given: every leg times its Cholesky factor."""
    plain = np.empty_like(white)
    for whitener, part, out in zip(
        rows.whiteners, rows.by_run(white), rows.by_run(plain), strict=True
    ):
        for (low, high), factors in zip(whitener.bounds, whitener.factors, strict=True):
            for component, factor in enumerate(factors):
                out[component, low:high] = factor @ part[component, low:high]
    return plain


def holding(plain, rows=None):
    """Rows with these deviations (r,), m, instead of the recorded ones."""
    return replace(rows or solved_rows(), plain_deviation=plain)


def noise(seed, level=1.0):
    """Plain deviations (r,), m, of noise as assumed, times a level."""
    rows = solved_rows()
    rng = np.random.default_rng([20250611, seed])
    return coloured(rows, level * rng.standard_normal(len(rows.deviation)))


@functools.cache
def options_of(effect, **shape):
    """Options of the formula of an effect, of one shape or of those it tries itself."""
    shapes = {effect.name: [shape]} if shape else {}
    tried, _ = tried_effects(solved_rows(), [effect], shapes)
    formulas = [t for t in tried[effect.name] if not t.terms.orders]
    return [t.source.option(take) for t in formulas for take in t.takes]


@dataclass(frozen=True)
class Given:
    """Columns that are there already."""

    given: Option

    def option(self, take):
        assert take.size == self.given.take.size
        return self.given

    def trace(self, take, value):
        return self.given.own[:, take] @ value

    def shared(self, pulled):
        return pulled.white.T @ self.given.own


def tried_with(rows, options):
    """Each of the given options as if made from these rows."""
    return {
        name: [
            ShapeProducts(
                o.effect,
                o.shape,
                replace(o.terms, axes=tuple(o.terms.axes[i] for i in o.take)),
                o.size,
                np.diag(o.own.T @ o.own),
                o.own.T @ o.own,
                o.own.T @ rows.residual,
                (np.arange(o.take.size),),
                Given(o),
            )
            for o in group
        ]
        for name, group in options.items()
    }


def cause_of(effect, **shape):
    """A cause with all terms of an effect, as if found by a search."""
    return Cause(options_of(effect, **shape)[0], 50.0, 1.0, ())


def trace_of(cause, **coefficients):
    """Plain deviations (r,), m, of a cause with coefficients by their names."""
    option = cause.option
    names = [option.terms.names[i] for i in option.take]
    assert set(coefficients) <= set(names)
    return option.plain @ np.array([coefficients.get(n, 0.0) for n in names])


def rms_um(plain):
    """Root mean square over the pieces of deviations (r,) of two components, um."""
    return 1e6 * float(np.sqrt(2 * np.mean(plain**2)))


def log_bayes_factor(columns, size, y, variance=1.0):
    """Density of y with and without an effect, as a logarithm; mean over three sizes of it.

    With the effect, y has the covariance ``variance`` + E D D' E'. Of y only what lies in the
    span of the columns tells the two apart, so densities are taken there.
    """
    basis = np.linalg.qr(columns)[0]
    seen, inner = basis.T @ y, basis.T @ columns
    noise_only = variance * np.eye(len(seen))
    scores = []
    for spread in (5e-7, 2e-6, 8e-6):
        width = inner * (spread / size)
        with_effect = multivariate_normal(cov=noise_only + width @ width.T)
        without = multivariate_normal(cov=noise_only)
        scores.append(with_effect.logpdf(seen) - without.logpdf(seen))
    return float(logsumexp(scores) - np.log(3))


def dense_base(rows):
    """Whitened columns of all unknowns that are projected out, shape (r, b)."""
    found = np.zeros((len(rows.deviation), len(rows.use)))
    for run in rows.touched:
        for some in run:
            found[np.ix_(some.rows, some.unknowns)] = some.base
    return found

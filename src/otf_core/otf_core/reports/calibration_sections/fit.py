# SPDX-License-Identifier: Apache-2.0
"""Size and quality of the fit."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammaincc

from otf_core.budget.budget import NOISE
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.quantities import dof_words, micro, whole_dof
from otf_core.reports.section import Section, Table


def section(facts: Facts) -> Section:
    """Return the section."""
    fit, result = facts.result.fit, facts.result
    budget = result.budget
    dof = dict(zip(budget.names, budget.freedoms.tolist(), strict=True))[NOISE]
    chance = float(gammaincc(0.5 * dof, 0.5 * dof * fit.variance_ratio))
    two, three = component_rms(facts)
    condition = facts.condition_number
    times = [c.correlation_time for run in result.runs for c in run.noise]
    rows = (
        ('samples', f'{fit.samples}'),
        ('samples used', f'{fit.used}, in {fit.pieces} path pieces'),
        ('outliers', f'{fit.outliers} ({100 * fit.outliers / fit.samples:.2f} %)'),
        ('effective degrees of freedom of the noise level (N_eff - rank)', dof_words(dof)),
        ('unknowns, the gauge being fixed', f'{fit.unknowns}'),
        ('rank', f'{fit.rank}'),
        ('condition number of the covariance (scaled)', f'{condition:.3g}'),
        ('s0, residuals over the noise assumed', f'{math.sqrt(fit.variance_ratio):.3f}'),
        ('chi-square p (chance of larger residuals by noise alone)', f'{chance:.3f}'),
        ('factor on the covariance for what remains', f'{fit.inflation:.3f}'),
        ('residual rms', f'{micro(fit.residual_rms)} um'),
        ('residual rms in the plane of the beam (a2), across it (a3)', f'{two} um, {three} um'),
        ('correlation time of the noise', _between(times)),
        ('iterations', f'{fit.iterations}'),
    )
    data = {
        'samples': fit.samples, 'used': fit.used, 'outliers': fit.outliers, 'pieces': fit.pieces,
        'unknowns': fit.unknowns, 'rank': fit.rank, 'condition': condition,
        's0': math.sqrt(fit.variance_ratio), 'chi_square_p': chance, 'dof': whole_dof(dof),
        'residual_rms': fit.residual_rms,
    }  # fmt: skip
    return Section('fit', 'Fit', (), data, (Table(('', ''), rows),))


def component_rms(facts: Facts) -> tuple[str, str]:
    """Root mean square residual of the first two directions across the path, um."""
    rows = np.concatenate([run.residual for run in facts.result.runs], axis=1)
    a, b = (float(np.sqrt(np.mean(row**2))) for row in rows[:2])
    return micro(a), micro(b)


def _between(times: list[float]) -> str:
    low, high = (f'{value:.2f}' for value in (min(times), max(times)))
    return f'{low} s' if low == high else f'{low} to {high} s'

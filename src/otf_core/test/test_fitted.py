# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the parameters of causes whose shape was refined."""

import numpy as np
from engine_cells import cause_of, holding, noise, solved_rows, trace_of

from otf_core.diagnosis.cause_parameters import curves_of, fitted_causes
from otf_core.diagnosis.engine.effect_products import tried_shapes
from otf_core.diagnosis.engine.search import Cause, fit_jointly
from otf_core.effects import REGISTRY
from otf_core.effects.action import vector
from otf_core.effects.free import Free
from otf_core.effects.free_form import Empirical, FreeForm
from otf_core.effects.inputs import CYCLE, found_name, functions_of, scaled_input, span_of

CYCLIC, BACKLASH = REGISTRY['cyclic_error'], REGISTRY['backlash']
PERIOD = 0.031


def test_uncertainty_of_a_period_is_in_that_of_the_amplitudes():
    """The same by one dense inverse of amplitudes and period together."""
    cause, other = cause_of(CYCLIC, period=PERIOD), cause_of(BACKLASH, held=1.0)
    rows = holding(trace_of(cause, S_X=4e-6, C_X=3e-6) + trace_of(other, B_Z=3e-6))
    causes = [cause, other]
    value = fit_jointly(causes, rows).value[: cause.option.take.size]
    traces = [
        cause_of(CYCLIC, period=p).option.own @ value for p in (PERIOD * 0.9999, PERIOD * 1.0001)
    ]
    slope = (traces[1] - traces[0]) / 2e-4
    columns = np.column_stack([cause.option.own, other.option.own, slope])
    weight = columns.T @ columns
    weight[-1, -1] += CYCLIC.refine_width**-2
    wanted = np.sqrt(np.diag(np.linalg.inv(weight)))[:-1]
    found = np.concatenate([part.u_seen for part in fitted_causes(causes, rows)])
    np.testing.assert_allclose(found, wanted, rtol=1e-3)
    alone = np.sqrt(np.diag(np.linalg.inv(weight[:-1, :-1])))
    assert (wanted / alone).max() > 1.2


def test_where_nothing_was_refined_the_uncertainty_is_that_of_the_coefficients():
    cause = cause_of(BACKLASH, held=1.0)
    rows = holding(trace_of(cause, B_X=4e-6))
    (part,) = fitted_causes([cause], rows)
    np.testing.assert_array_equal(part.covariance, fit_jointly([cause], rows).covariance)
    assert len(part.u_seen) == len(solved_rows().tables.machine.axis_names)


def test_uncertainty_grows_with_what_the_causes_leave():
    """Noise three times as loud as that of the standstills; thirty legs show a little less."""
    cause = cause_of(BACKLASH, held=1.0)
    planted = trace_of(cause, B_X=4e-6)
    (quiet,) = fitted_causes([cause], holding(planted))
    loud = [fitted_causes([cause], holding(planted + 3.0 * noise(k)))[0] for k in range(4)]
    ratios = np.concatenate([part.u_seen / quiet.u_seen for part in loud])
    assert 2.0 < np.mean(ratios) < 3.2


def found_form(free, coefficients, seed=3):
    """A shift that depends on inputs as a search for a cause without a name fits it."""
    rows = solved_rows()
    spans = {n: span_of(rows.states, n) for n in free.inputs}
    effect = FreeForm(Empirical(), free, spans)
    shift = rows.displacement(effect, {}, np.array(coefficients)[:, None])[:, 0]
    rows = holding(shift + noise(seed))
    (tried,) = tried_shapes(rows, effect, [{}])
    option = tried.made(np.arange(len(tried.size)), 1.0)
    return fitted_causes([Cause(option, 50.0, 1.0, ())], rows)[0]


def test_the_band_of_a_curve_holds_what_the_data_see():
    """The mean of a shift is the place of the tracker as well: it is in no band."""
    period, wave = 40.0, np.array([0.0, 5e-6, -3e-6])
    name = found_name(CYCLE, period)
    part = found_form(Free((name,), (2,), acts=vector), [*wave, *np.zeros(6)])
    (curve,) = (c for c in curves_of(part) if c.term == 'X')
    at, value, u = (np.array(v) for v in (curve.at, curve.value, curve.u))
    off = value - functions_of(name, 2.0 * np.mod(at, period) / period - 1.0, 2) @ wave
    assert np.abs(off - off.mean()).max() < 4.0 * u.max() < 2e-6
    assert np.sqrt(part.covariance[0, 0]) > 10.0 * u.max()  # the mean is as unknown as before


def test_a_curve_that_the_data_see_whole_has_its_whole_band():
    """Zero at the start, so that nothing else holds its mean."""
    free = Free(('time',), (2,), least=(1,), acts=vector, zero_at=-1.0)
    part = found_form(free, [4e-6, -2e-6, *np.zeros(4)])
    (curve,) = (c for c in curves_of(part) if c.term == 'X')
    effect = part.cause.option.effect
    at = scaled_input('time', np.array(curve.at), effect.spans['time'])
    table, covariance = effect.functions([at]), part.covariance[:2, :2]
    wanted = np.sqrt(np.einsum('ij,jk,ik->i', table, covariance, table))
    np.testing.assert_allclose(curve.u, wanted, rtol=1e-6, atol=1e-15)
    assert 0.0 < wanted[-1] < 1e-6

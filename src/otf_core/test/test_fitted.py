# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the parameters of causes whose shape was refined."""

import numpy as np
from engine_cells import cause_of, holding, noise, solved_rows, trace_of

from otf_core.diagnosis.engine.search import fit_jointly
from otf_core.diagnosis.fitted import fitted_causes
from otf_core.effects import REGISTRY

CYCLIC, BACKLASH = REGISTRY['cyclic_error'], REGISTRY['backlash']
PERIOD = 0.031


def test_uncertainty_of_a_period_is_in_that_of_the_amplitudes():
    """The same by one dense inverse of amplitudes and period together."""
    cause, other = cause_of(CYCLIC, period=PERIOD), cause_of(BACKLASH, held=1.0)
    rows = holding(trace_of(cause, S_X=4e-6, C_X=3e-6) + trace_of(other, B_Z=3e-6) + noise(3))
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
    rows = holding(trace_of(cause, B_X=4e-6) + noise(3))
    (part,) = fitted_causes([cause], rows)
    np.testing.assert_array_equal(part.covariance, fit_jointly([cause], rows).covariance)
    assert len(part.u_seen) == len(solved_rows().tables.machine.axis_names)

# SPDX-License-Identifier: Apache-2.0
"""Causes that stand beside what has no name, and those that only imitate it."""

import numpy as np
from engine_cells import holding, noise, solved_rows

from otf_core.diagnosis.engine.search import search, tried_effects
from otf_core.diagnosis.standing_causes import stand_beside, standing_causes
from otf_core.effects import REGISTRY

LEAST_UM = 0.3


def held(displacement):
    """Rows that hold noise and a displacement of the pieces."""
    rows = solved_rows()
    parts = [
        np.einsum('cpk,pk->cp', run.system.axes, displacement(state)).ravel()
        for run, state in zip(rows.done.runs, rows.states, strict=True)
    ]
    return holding(noise(11) + np.concatenate(parts))


def lagging(s):
    return 5e-6 * (s.speed * s.direction[:, 0] / s.speed.max())[:, None] * [1, 0, 0]


def sagging(s):
    u = 2 * s.q[:, 0] / s.machine.upper[0] - 1
    return (8e-6 * s.time / s.end * np.exp(-2 * u**2))[:, None] * [0, 0, 1]


def found_in(rows, *names):
    return search(rows, tried_effects(rows, [REGISTRY[n] for n in names], {})[0])[0]


def test_a_cause_stays_named_beside_what_has_no_name_in_whatever_order_they_were_found():
    rows = held(lambda s: lagging(s) + sagging(s))
    causes = found_in(rows, 'servo_mismatch', 'thermal_structure_drift')
    assert {c.option.effect.name for c in causes} == {'servo_mismatch', 'thermal_structure_drift'}
    found = standing_causes(rows, causes, LEAST_UM)
    assert [c.option.effect.name for c in found.causes] == ['servo_mismatch']
    assert set(found.structures[0].inputs) == {'time', 'x'}
    alone = stand_beside(rows, causes)
    assert found.residuals.rms_um < 1.1 * alone.residuals.rms_um
    assert found.confidence(0, None) > 0.99
    other = standing_causes(rows, causes[::-1], LEAST_UM)
    assert [c.option.effect for c in found.causes] == [c.option.effect for c in other.causes]
    np.testing.assert_allclose(found.residuals.rms_um, other.residuals.rms_um, rtol=1e-3)


def test_what_only_imitates_a_cause_without_a_name_falls():
    rows = held(sagging)
    causes = found_in(rows, 'thermal_structure_drift')
    assert causes
    assert standing_causes(rows, causes, LEAST_UM) is None

# SPDX-License-Identifier: Apache-2.0
"""Limits of machines with rotary axes."""

from dataclasses import replace

import numpy as np
import pytest
from test_chain import constant
from test_rotary_exports import five_axes

from otf_core.budget.budget import NOISE, Budget, Source
from otf_core.calibration.machine_verdict import judge
from otf_core.errors import ConfigError
from otf_core.model.machine import machine_from_dict
from otf_core.model.sections import Limits
from otf_core.model.tables import MotionTable, ScalarError
from otf_core.prediction.volumetric import table_places

SIZE = 2e-5


def cell(limits):
    """A machine whose only errors are ECC, from -1 to 1 times a size, and X0C."""
    machine = replace(five_axes(), limits=Limits(limits))
    ends = {a: np.linspace(v.min, v.max, 5) for a, v in machine.axes.items()}
    motions = {m: MotionTable(ends[m.axis], np.zeros(5), np.zeros(5)) for m in machine.motions}
    motions['ECC'] = replace(motions['ECC'], value=np.linspace(-SIZE, SIZE, 5))
    location = {n: ScalarError(SIZE if n == 'X0C' else 0.0) for n in machine.location}
    return replace(constant(machine), motions=motions, location=location)


def judged(limits, hidden=()):
    tables = cell(limits)
    size = max(place.stop for place in table_places(tables).values())
    covariance = 1e-12 * np.eye(size)
    sources = (Source(NOISE, covariance, np.inf),)
    budget = Budget(sources, (), 1.0, np.eye(size), np.zeros(size))
    verdict = judge(tables, covariance, budget, hidden)
    return {one.name: one for one in verdict.limits}


@pytest.mark.parametrize(('limit', 'state'), [(4.5e-5, 'pass'), (4.1e-5, 'not proven'),
                                              (3.5e-5, 'fail')])  # fmt: skip
def test_span_of_a_rotary_motion_is_judged_with_its_uncertainty(limit, state):
    one = judged({'ECC': limit})['ECC']
    assert (one.unit, one.state) == ('rad', state)
    assert one.value == pytest.approx(2 * SIZE)
    assert pytest.approx(2 * np.sqrt(2) * 1e-6) == one.U


def test_location_errors_and_volume_are_judged_and_the_unseen_is_not_known():
    found = judged(
        {'X0C': 1e-5, 'A0C': 1e-5, 'volumetric_error': 1e-7, 'uncertainty': 1e-3}, ['A0C']
    )
    states = {name: one.state for name, one in found.items()}
    assert states == {
        'X0C': 'fail', 'A0C': 'not known', 'volumetric_error': 'fail', 'uncertainty': 'pass',
    }  # fmt: skip
    assert found['X0C'].unit == 'm'
    assert found['volumetric_error'].value > 5e-6


def test_limits_of_axes_that_the_machine_lacks_are_refused():
    data = five_axes().to_dict()
    data['limits'] = {'ECC': 1e-5, 'Y0A': 2e-5}
    assert machine_from_dict(data).limits.values == {'ECC': 1e-5, 'Y0A': 2e-5}
    data['limits'] = {'ECB': 1e-5}
    with pytest.raises(ConfigError, match='ECB'):
        machine_from_dict(data)


def test_uncertainty_of_the_target_offset_is_that_of_the_place_of_the_tool():
    data = five_axes().to_dict()
    data.pop('targets', None)
    data['uncertainty'] = {'preset': 'workshop', 'tracker_scale': 1e-6}
    machine = machine_from_dict(data)
    assert machine.targets['tool'].u == 0.0  # a preset knows nothing of this reflector
    assert 'target_offset' not in machine.uncertainty.values
    data['uncertainty']['target_offset'] = 2e-5
    assert machine_from_dict(data).targets['tool'].u == 2e-5
    data['targets'] = {'tool': {'u': 4e-6}}
    machine = machine_from_dict(data)
    assert machine.targets['tool'].u == 4e-6
    assert machine_from_dict(machine.to_dict()).to_dict() == machine.to_dict()

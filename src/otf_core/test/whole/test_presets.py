# SPDX-License-Identifier: Apache-2.0
"""Classes of trackers and workshops, and what u would be with typical contributions."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.calibration.calibrate import calibrate
from otf_core.config import ForecastConfig
from otf_core.errors import ConfigError
from otf_core.model.evaluation import lattice
from otf_core.model.machine import machine_from_dict
from otf_core.model.presets import TRACKERS, WORKSHOPS, typical_values
from otf_core.model.sections import DeclaredUncertainty
from otf_core.planning.forecast import (
    Setup,
    forecast,
    free_uncertainty,
    planned_systematic,
)
from otf_core.planning.plan_report import PlanReport
from otf_core.reports.plan_files import plan_summary


def described(tracker=None, uncertainty=None):
    """Machine from plain data with these sections."""
    data = some_machine().to_dict()
    if tracker is not None:
        data['tracker'] = tracker
    if uncertainty is not None:
        data['uncertainty'] = uncertainty
    return machine_from_dict(data)


# ---------------------------------------------------------------- presets


@pytest.mark.parametrize('name', TRACKERS)
def test_a_tracker_preset_gives_noise_and_declares_the_tracker(name):
    machine = described({'preset': name})
    values = TRACKERS[name].values
    assert (machine.tracker.u_range, machine.tracker.u_angle) == (
        values['u_range'],
        values['u_angle'],
    )
    assert dict(machine.uncertainty.values) == {
        k: v for k, v in values.items() if k.startswith('tracker_')
    }


def test_given_keys_win_over_presets():
    machine = described(
        {'preset': 'ltd-class', 'u_angle': 7e-6},
        {'preset': 'hall', 'tracker_scale': 0.0, 'air_temperature': 0.1},
    )
    assert machine.tracker.u_angle == 7e-6
    assert machine.tracker.u_range == TRACKERS['ltd-class'].values['u_range']
    values = machine.uncertainty.values
    assert (values['tracker_scale'], values['air_temperature']) == (0.0, 0.1)
    assert values['tracker_angle'] == TRACKERS['ltd-class'].values['tracker_angle']
    assert values['machine_temperature'] == WORKSHOPS['hall'].values['machine_temperature']


@pytest.mark.parametrize(
    ('tracker', 'uncertainty', 'words'),
    [
        (
            {'preset': 'at960'},
            None,
            "tracker: preset: 'at960' is not a preset; known here: absolute-",
        ),
        (
            None,
            {'preset': 'shed'},
            "uncertainty: preset: 'shed' is not a preset; known here: labor",
        ),
        ({'preset': 3}, None, 'tracker: preset: expected text'),
        ({'preset': 'ltd-class', 'u_rang': 1e-6}, None, 'tracker: u_rang: unknown key'),
        ({'preset': 'ltd-class', 'u_range': 0}, None, 'tracker: u_range: 0 is out of range'),
        ({'u_range': 1e-6}, None, 'tracker: u_angle: missing'),
        (
            {'preset': 'workshop'},
            None,
            'is not a preset; known here: absolute-interferometer, abs',
        ),
    ],
)
def test_wrong_presets_name_the_key_and_what_is_known(tracker, uncertainty, words):
    with pytest.raises(ConfigError) as caught:
        described(tracker, uncertainty)
    assert words in str(caught.value)


# ---------------------------------------------------------------- what u would be


def with_declared(cell, values):
    machine = replace(cell.machine, uncertainty=DeclaredUncertainty(values))
    return calibrate(cell.recording.measured(cell.truth), cell.path, machine)


def test_u_with_typical_contributions_is_that_of_a_calibration_that_declares_them(
    cell, calibrated
):
    whole = with_declared(cell, typical_values())
    for name, table in whole.tables.motions.items():
        found = calibrated.tables.motions[name]
        np.testing.assert_allclose(found.u, table.u, rtol=1e-6, atol=1e-15)
        np.testing.assert_allclose(found.u_run, table.u_run, rtol=1e-6, atol=1e-15)
    for name, own in calibrated.tables.squareness.items():
        assert own.u == pytest.approx(whole.tables.squareness[name].u)
    assert calibrated.headline.u['mean'] > 4 * calibrated.headline.u_run['mean']
    assert whole.typical is None
    assert not any('typical' in text for text in whole.warnings)
    assert whole.to_dict()['typical_systematic'] is None


def test_what_is_declared_in_part_is_missing_in_part(cell):
    some = {
        k: v for k, v in typical_values().items() if k not in ('tracker_angle', 'air_pressure')
    }
    partly, whole = with_declared(cell, some), with_declared(cell, typical_values())
    typical = partly.typical
    assert typical.missing == ('air', 'tracker angles')
    assert set(typical.assumed) == {'tracker_angle', 'air_pressure'}
    assert partly.warnings[0].startswith('machine.yaml declares nothing for air, tracker angles: ')
    assert partly.headline.systematic == 'typical'
    for name in ('EXX', 'EYX', 'EAX'):
        u = whole.tables.motions[name].u
        np.testing.assert_allclose(partly.tables.motions[name].u, u, rtol=1e-6, atol=1e-15)


# ---------------------------------------------------------------- before measuring


def planned(machine, plan):
    """What the forecast says of systematic contributions, and its text."""
    setup = Setup.of(machine, config=ForecastConfig(rate=100.0))
    found = forecast(plan, setup)
    systematic = planned_systematic(found)
    report = PlanReport(plan, 'given', setup, found, (), (), (), (), systematic, (), {}, (), {})
    data = report.document.to_dict()
    return systematic, plan_summary(data), data


def test_a_forecast_with_declared_contributions_is_what_the_calibration_states(cell):
    machine = replace(cell.machine, uncertainty=DeclaredUncertainty(typical_values()))
    rotation, place = np.eye(3), Setup.of(machine).place
    samples = cell.recording.measured(cell.truth, pose=(rotation, place))
    result = calibrate(samples, cell.path, machine)
    found, text, _ = planned(machine, cell.plan)
    assert found.missing == ()
    nodes = {a: result.tables.motions[f'E{a}{a}'].position for a in 'XYZ'}
    free = free_uncertainty(machine, nodes, result.covariance, lattice(machine, 7))
    stated = np.linalg.norm(free, axis=1).mean()
    assert found.with_declared == pytest.approx(stated, rel=0.05)
    first = result.headline
    assert text.splitlines()[0].endswith('systematic contributions as declared)')
    assert found.expected.expanded == pytest.approx(first.expanded, rel=0.05)

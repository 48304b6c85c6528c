# SPDX-License-Identifier: Apache-2.0
"""Classes of trackers and workshops, and what u would be with typical contributions."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.calibration.calibrate import calibrate
from otf_core.config import ForecastConfig
from otf_core.errors import ConfigError
from otf_core.model.evaluation import lattice
from otf_core.model.machine import machine_from_dict
from otf_core.model.presets import NOISE, TRACKERS, WORKSHOPS, typical_values
from otf_core.model.sections import DECLARABLE, DeclaredUncertainty
from otf_core.planning.forecast import (
    Setup,
    forecast,
    free_uncertainty,
    planned_systematic,
)
from otf_core.planning.plan_report import PlanReport
from otf_core.reports.plan_files import plan_summary

ROOT = Path(__file__).resolve().parents[4]


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


def test_tracker_and_workshop_together_declare_everything():
    for tracker in TRACKERS:
        for workshop in WORKSHOPS:
            machine = described({'preset': tracker}, {'preset': workshop})
            assert set(machine.uncertainty.values) == set(DECLARABLE)
    assert set(typical_values()) == set(DECLARABLE)


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


def test_the_echo_names_the_presets_and_stands_on_its_own():
    machine = described({'preset': 'absolute-distance-meter'}, {'preset': 'workshop'})
    echo = machine.to_dict()
    assert echo['tracker'] == {
        'u_range': 1.0e-6,
        'u_angle': 3.5e-6,
        'preset': 'absolute-distance-meter',
    }
    assert echo['uncertainty']['preset'] == 'workshop'
    assert set(echo['uncertainty']) == {*DECLARABLE, 'preset'}
    assert machine_from_dict(echo).to_dict() == echo
    plain = json.loads(json.dumps(echo))
    del plain['tracker']['preset'], plain['uncertainty']['preset']
    again = machine_from_dict(plain)
    assert dict(again.uncertainty.values) == dict(machine.uncertainty.values)
    assert again.tracker.u_range == machine.tracker.u_range


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


def test_harder_conditions_are_not_less_uncertain():
    for presets in (TRACKERS, WORKSHOPS):
        best, *others = presets.values()
        for other in others:
            for key, value in best.values.items():
                # a distance meter is better in scale than an interferometer
                assert other.values[key] >= value or key == 'tracker_scale', (other.what, key)
    for preset in (*TRACKERS.values(), *WORKSHOPS.values()):
        assert preset.sources
        assert set(preset.values) <= {*DECLARABLE, *NOISE}


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


def test_undeclared_contributions_are_a_warning(calibrated):
    first = calibrated.warnings[0]
    assert first.startswith('machine.yaml declares nothing for tracker scale, air, ')
    assert (
        'u includes typical values for them (presets absolute-interferometer, workshop)' in first
    )
    found = calibrated.to_dict()
    assert found['warnings'][0] == found['typical_systematic']['sentence'] == first
    for motion in found['motions'].values():
        assert np.all(np.array(motion['u']) >= motion['u_run'])
    c0y = found['squareness']['C0Y']
    assert c0y['u'] > c0y['u_run']
    assert found['typical_systematic']['assumed'] == typical_values()
    assert found['systematic'] == 'typical'


def test_the_headline_is_the_same_whether_typical_values_are_declared_or_assumed(cell, calibrated):
    whole = with_declared(cell, typical_values()).headline
    first = calibrated.headline
    assert (first.systematic, whole.systematic) == ('typical', 'declared')
    assert len(first.typical_for) == 6 and whole.typical_for == ()
    for own, other in ((first.expanded, whole.expanded), (first.observed, whole.observed)):
        assert own == pytest.approx(other, rel=0.2)
    assert first.error == pytest.approx(whole.error, rel=0.01)
    assert first.u_of_largest == pytest.approx(whole.u_of_largest, rel=0.2)
    assert first.k == whole.k == 2.0
    assert all(first.observed[k] < 0.3 * first.expanded[k] for k in first.expanded)
    assert 'typical, not declared' in first.expanded_words
    assert 'as declared' in whole.expanded_words


def test_nothing_systematic_is_assumed_where_it_is_declared_to_be_zero(cell):
    nothing = with_declared(cell, dict.fromkeys(DECLARABLE, 0.0)).headline
    assert nothing.expanded == pytest.approx(nothing.observed)


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


def test_zero_declares_that_there_is_nothing(cell, calibrated):
    nothing = with_declared(cell, dict.fromkeys(DECLARABLE, 0.0))
    assert nothing.typical is None
    assert nothing.budget.not_stated == ()
    np.testing.assert_allclose(
        nothing.tables.motions['EXX'].u, calibrated.tables.motions['EXX'].u_run, rtol=1e-9
    )
    machine = described(uncertainty=dict.fromkeys(DECLARABLE, 0.0))
    assert set(machine.uncertainty.values.values()) == {0.0}


# ---------------------------------------------------------------- before measuring


def planned(machine, plan):
    """What the forecast says of systematic contributions, and its text."""
    setup = Setup.of(machine, config=ForecastConfig(rate=100.0))
    found = forecast(plan, setup)
    systematic = planned_systematic(found)
    report = PlanReport(plan, 'given', setup, found, (), (), (), (), systematic, (), {}, (), {})
    data = report.document.to_dict()
    return systematic, plan_summary(data), data


def test_a_forecast_says_that_it_holds_noise_only_and_what_else_there_is(cell):
    found, text, data = planned(cell.machine, cell.plan)
    assert found.declared == ()
    assert len(found.missing) == 6
    assert found.with_declared == found.noise
    assert found.with_typical > 3 * found.noise
    first, second = text.splitlines()[:2]
    assert first == found.expected.expanded_words
    assert 'typical, not declared in machine.yaml' in first
    assert second == found.expected.forecast_words
    assert found.expected.expanded['mean'] == pytest.approx(2 * found.with_typical)
    assert found.expected.observed['mean'] == pytest.approx(2 * found.noise)
    assert data['forecast']['holds'] == 'noise'
    assert data['systematic']['mean_grid_u_with_typical'] == found.with_typical


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

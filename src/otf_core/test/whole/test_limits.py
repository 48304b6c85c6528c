# SPDX-License-Identifier: Apache-2.0
"""Limits of machine.yaml: how they are read, and the verdict with its guard band."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from cli_cells import run
from core_cells import error_of, some_machine
from nature import table_rows

from otf_core.bags.bag import BagContent, write_bag
from otf_core.calibration.calibrate import calibrate
from otf_core.calibration.calibration_result import headline_of
from otf_core.calibration.machine_verdict import judge, measurement_verdict
from otf_core.errors import ConfigError
from otf_core.model.evaluation import lattice
from otf_core.model.machine import machine_from_dict
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.sections import Limits
from otf_core.model.tables import MotionTable
from otf_core.prediction.calibration_document import Verdicts
from otf_core.prediction.volumetric import VolumetricError

GIVEN = {
    'limits': {'volumetric_error': 2e-5, 'uncertainty': 2e-6, 'EXX': 5e-6, 'C0Y': 1e-5},
    'instrument': {'model': 'AT960', 'serial': '750123'},
    'conditions': {'operator': 'A. Miller', 'air_temperature_celsius': 20.4},
}


def described(**more):
    return {**some_machine().to_dict(), **more}


def test_sections_survive_a_round_trip_and_may_be_missing():
    data = described(**GIVEN)
    machine = machine_from_dict(data)
    assert machine.limits.values == GIVEN['limits']
    assert machine_from_dict(machine.to_dict()).to_dict() == data
    plain = machine_from_dict(described())
    assert plain.limits is None
    assert not set(GIVEN) & set(plain.to_dict())


def test_every_error_of_the_model_can_have_a_limit():
    limits = dict.fromkeys(('volumetric_error', 'uncertainty', *MOTIONS, *SQUARENESS), 1e-6)
    assert machine_from_dict(described(limits=limits)).limits.values == limits


@pytest.mark.parametrize(
    ('section', 'content', 'words'),
    [
        ('limits', {'EXW': 1e-6}, 'limits: EXW: unknown key; known here: volumetric_error'),
        ('limits', {'EXX': 0.0}, 'limits: EXX: 0 is out of range; must be above 0'),
        ('limits', {'EXX': 5.0}, 'is it in um? Write 5e-06 m'),
        (
            'limits',
            {'C0Y': 'small'},
            "limits: C0Y: expected a plain number in SI units, got 'small'",
        ),
        ('limits', [1], 'limits: expected a mapping of keys to values, got list'),
        ('instrument', {'serial': 750123}, 'instrument: serial: expected text, got 750123'),
        ('instrument', {'colour': 'red'}, 'instrument: colour: unknown key'),
        (
            'conditions',
            {'air_temperature_celsius': 293.15},
            'must be at least -50 and at most 100',
        ),
        ('conditions', {'air_temperature': 20}, 'conditions: air_temperature: unknown key'),
    ],
)
def test_what_is_wrong_is_named(section, content, words):
    with pytest.raises(ConfigError) as caught:
        machine_from_dict(described(**{section: content}))
    assert words in str(caught.value)


def verdict(calibrated, **limits):
    machine = replace(calibrated.tables.machine, limits=Limits(limits))
    tables = replace(calibrated.tables, machine=machine)
    return judge(tables, calibrated.covariance, calibrated.budget, calibrated.not_identifiable)


def state(calibrated, **limits):
    (one,) = verdict(calibrated, **limits).limits
    return one.state


@pytest.fixture(scope='module')
def by_hand(calibrated):
    """Value and U (k = 2) of quantities, from tables and covariance alone."""
    tables, cover = calibrated.tables, calibrated.covariance
    found, start = {}, len(SQUARENESS)
    for k, name in enumerate(SQUARENESS):
        found[name] = abs(tables.squareness[name].value), 2 * np.sqrt(cover[k, k])
    for name in MOTIONS:
        value = tables.motions[name].value
        a, b = start + int(value.argmax()), start + int(value.argmin())
        variance = cover[a, a] + cover[b, b] - 2 * cover[a, b]
        found[name] = float(np.ptp(value)), 2 * np.sqrt(variance)
        start += len(value)
    return found


@pytest.mark.parametrize('name', ['EXX', 'EYX', 'EBX', 'C0Y', 'A0Z'])
def test_guard_band_lies_on_both_sides_of_the_limit(calibrated, by_hand, name):
    value, wide = by_hand[name]
    assert name not in calibrated.not_identifiable
    assert state(calibrated, **{name: value + 1.1 * wide}) == 'pass'
    assert state(calibrated, **{name: value + 0.7 * wide}) == 'not proven'
    assert state(calibrated, **{name: value - 0.7 * wide}) == 'not proven'
    assert state(calibrated, **{name: value - 1.1 * wide}) == 'fail'


def test_volumetric_error_is_judged_where_it_decides(calibrated):
    tables, machine = calibrated.tables, calibrated.tables.machine
    grid = lattice(machine)
    rigid = np.zeros((len(grid), 3, 6))
    rigid[:, :, :3] = np.eye(3)
    for k in range(3):
        rigid[:, :, 3 + k] = np.cross(np.eye(3)[k], grid)
    rigid = rigid.reshape(-1, 6)
    rows, _ = table_rows(tables, str(machine.chain), machine.target_offset, grid)
    flat = np.asarray(rows).reshape(len(grid) * 3, -1)
    flat = flat - rigid @ np.linalg.lstsq(rigid, flat, rcond=None)[0]
    error = error_of(tables, grid).reshape(-1)
    error = (error - rigid @ np.linalg.lstsq(rigid, error, rcond=None)[0]).reshape(-1, 3)
    length = np.linalg.norm(error, axis=1)
    along = np.einsum('nk,nkm->nm', error / length[:, None], flat.reshape(len(grid), 3, -1))
    wide = 2 * np.sqrt(np.einsum('nm,mk,nk->n', along, calibrated.covariance, along))
    top, sure = (length + wide).max(), (length - wide).max()
    band = top - sure
    assert state(calibrated, volumetric_error=top + 0.1 * band) == 'pass'
    assert state(calibrated, volumetric_error=0.5 * (top + sure)) == 'not proven'
    assert state(calibrated, volumetric_error=sure - 0.1 * band) == 'fail'
    whole = flat @ calibrated.covariance
    u = np.sqrt(np.einsum('ij,ij->i', whole, flat).reshape(-1, 3).sum(axis=1)).max()
    assert state(calibrated, uncertainty=2.05 * u) == 'pass'
    assert state(calibrated, uncertainty=1.9 * u) == 'fail'


def test_nothing_is_known_where_the_machine_was_not_driven(calibrated):
    tables = calibrated.tables
    machine = tables.machine
    longer = replace(machine.axes['X'], max=machine.axes['X'].max + 0.1)
    wide = replace(
        calibrated,
        tables=replace(tables, machine=replace(machine, axes={**machine.axes, 'X': longer})),
    )
    limits = {'volumetric_error': 1e-2, 'uncertainty': 1e-2, 'EXX': 1e-2, 'EYY': 1e-2}
    states = [one.state for one in verdict(wide, **limits).limits]
    assert states == ['not known', 'not known', 'not known', 'pass']
    # what is stated first is that of the driven volume
    sizes = [
        headline_of(VolumetricError(c.tables, c.covariance), c.budget, None)
        for c in (calibrated, wide)
    ]
    assert sizes[0].expanded == sizes[1].expanded


def test_what_the_data_do_not_show_does_not_pass(calibrated):
    hidden = next(n for n in calibrated.not_identifiable if n in MOTIONS)
    found = verdict(calibrated, **{hidden: 1e-3, 'volumetric_error': 1e-2})
    assert [one.state for one in found.limits] == ['not known', 'pass']
    assert found.state != 'pass'
    assert 'the data do not show it' in found.limits[0].words
    assert '1 of 2 limits not known' in found.sentence


def test_nothing_is_proven_of_a_volume_of_which_an_axis_stood(calibrated):
    tables = calibrated.tables
    still = {
        m: MotionTable(t.position[:1], np.zeros(1), np.zeros(1), identifiable=False)
        for m, t in tables.motions.items()
        if m.axis == 'Z'
    }
    stood = replace(tables, motions={**tables.motions, **still})
    limits = {'volumetric_error': 1e-2, 'uncertainty': 1e-2}
    stood = replace(stood, machine=replace(stood.machine, limits=Limits(limits)))
    found = judge(stood, calibrated.covariance, calibrated.budget, tuple(still))
    assert [one.state for one in found.limits] == ['not known', 'not known']


def test_without_limits_there_is_no_verdict(calibrated):
    assert calibrated.verdicts.words[1] == 'machine: no limits stated in machine.yaml'
    assert calibrated.verdicts.exit_code == 0
    assert verdict(calibrated, volumetric_error=1e-2).state == 'pass'


def test_limits_decide_the_exit_code_and_a_line_of_the_terminal(cell, tmp_path, capsys):
    write_bag(tmp_path / 'bag', BagContent(cell.recording.measured(cell.truth), cell.path))
    data = {**cell.machine.to_dict(), 'limits': {'volumetric_error': 1e-2, 'EXX': 1e-6}}
    (tmp_path / 'machine.yaml').write_text(yaml.safe_dump(data))
    given = (tmp_path / 'bag', '--machine', tmp_path / 'machine.yaml', {'report': False})
    assert run('calibrate', *given, '--out', tmp_path / 'out') == 5
    said = capsys.readouterr()
    lines = said.out.splitlines()
    assert 'measurement: good, all checks passed' in lines
    assert 'machine: 1 of 2 limits broken (guard band U, ISO 14253-1)' in lines
    assert len([line for line in lines if line.startswith('  EXX ')]) == 1, 'said once'
    assert 'quality gate' not in said.out + said.err
    assert not (tmp_path / 'out' / 'report.html').exists()
    data = json.loads((tmp_path / 'out' / 'error_tables.json').read_text())
    assert data['failed_gates'] == []
    verdicts = data['verdicts']
    assert verdicts['measurement']['good'] is True
    assert verdicts['machine']['state'] == 'fail'
    assert [one['state'] for one in verdicts['machine']['limits']] == ['pass', 'fail']


def test_a_bad_measurement_is_no_verdict_on_the_machine(calibrated):
    machine = verdict(calibrated, volumetric_error=1e-2, EXX=1e-6)
    gate = 'coverage: 62 % of the path driven, 80 % needed'
    both = Verdicts(measurement_verdict([gate]), machine)
    assert both.exit_code == 4
    assert both.words[0] == f'measurement: NOT GOOD, {gate}'
    assert both.words[1].startswith('machine: 1 of 2 limits broken')
    assert Verdicts(measurement_verdict(()), machine).exit_code == 5
    kept = verdict(calibrated, volumetric_error=1e-2)
    assert Verdicts(measurement_verdict(()), kept).exit_code == 0


def test_limits_are_judged_with_the_uncertainty_of_the_headline(cell, calibrated):
    limits = Limits({'uncertainty': 2 * calibrated.headline.observed['max']})
    machine = replace(cell.machine, limits=limits)
    found = calibrate(cell.recording.measured(cell.truth), cell.path, machine)
    (one,) = found.verdicts.machine.limits
    assert one.value == pytest.approx(found.headline.expanded['max'], rel=1e-9)
    assert one.state == 'fail', 'noise alone would keep it'

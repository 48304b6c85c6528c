# SPDX-License-Identifier: Apache-2.0
"""Limits of machine.yaml: how they are read, and the verdict with its guard band."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import error_of, some_machine
from nature import table_rows

from otf_core.calibration.calibration_result import headline_of
from otf_core.calibration.machine_verdict import judge
from otf_core.model.evaluation import lattice
from otf_core.model.machine import machine_from_dict
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.sections import Limits
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

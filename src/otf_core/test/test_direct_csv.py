# SPDX-License-Identifier: Apache-2.0
"""Text files of direct measurements, read back and refused."""

import numpy as np
import pytest
from core_cells import some_machine
from direct_instrument import measure_directly
from direct_texts import write_direct_csv

from otf_core.comparison.direct import motion_readings, read_direct_csv
from otf_core.errors import ConfigError, InputError
from otf_core.model.machine import AXES
from otf_core.sim.cell import random_tables


def test_csv_of_a_measurement_is_read_back_exactly(tmp_path):
    machine = some_machine()
    measurement = measure_directly(
        random_tables(machine, 2e-5, np.random.default_rng(3)), 5, runs=2, positions=4
    )
    write_direct_csv(tmp_path / 'd.csv', measurement)
    found = read_direct_csv(tmp_path / 'd.csv', machine)
    assert found.u_length_scale == measurement.u_length_scale
    assert found.remarks == ()
    for axis in AXES:
        np.testing.assert_array_equal(found.axes[axis].value, measurement.axes[axis].value)
        np.testing.assert_array_equal(found.axes[axis].point, measurement.axes[axis].point)


ROWS = [(0.0, 0.0, 0.0), (100.0, 2.0, 1.0)]


def small_csv(header='axis,run,direction,position_mm,EX_um,EA_arcsec', rows=None):
    if rows is None:
        rows = [
            f'X,{run},{way},{p},{x},{a}'
            for run in (1, 2) for way in ('forward', 'backward') for p, x, a in ROWS
        ]  # fmt: skip
    return '\n'.join(['# point X: 0,0.1,-0.05', header, *rows]) + '\n'


def test_units_stand_in_the_header(tmp_path):
    file = tmp_path / 'd.csv'
    file.write_text(small_csv())
    readings = read_direct_csv(file, some_machine()).axes['X']
    np.testing.assert_allclose(readings.position, [0.0, 0.1])
    np.testing.assert_allclose(readings.value[0, 0, 1, [0, 3]], [2e-6, np.pi / 648000])
    np.testing.assert_array_equal(readings.measured, [True, False, False, True, False, False])
    np.testing.assert_allclose(readings.point[1:], [0.1, -0.05])


def test_a_lever_without_its_rotation_is_refused(tmp_path):
    file = tmp_path / 'd.csv'
    file.write_text(small_csv())
    machine = some_machine()
    with pytest.raises(InputError, match='axis X: EBX was not measured'):
        motion_readings(read_direct_csv(file, machine), machine)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'holds no readings'),
        ('a,b\n1,2\n', 'line 1: header: axis: missing'),
        (small_csv(header='axis,run,direction,position_mm,EX_ft,EA_rad'), 'EX_ft: unit'),
        (small_csv(rows=['W,1,forward,0,0,0']), "line 3: axis: 'W'"),
        (small_csv(rows=['X,1,up,0,0,0']), "line 3: direction: 'up'"),
        (small_csv(rows=['X,1,forward,zero,0,0']), 'line 3: expected a reading'),
        (small_csv(rows=['X,1,forward,inf,0,0']), 'line 3: position and errors'),
        (small_csv(rows=['X,1,forward,0,0,0', 'X,1,forward,9,0,0']), 'backward, position 0: 0'),
        (small_csv().replace('0.1,-0.05', '0.1'), 'line 1: point X: expected 3 numbers'),
        (f'# target_offset: 0,,-0.1\n{small_csv()}', 'line 1: target_offset: expected 3 numbers'),
        (f'# u_length_scale:\n{small_csv()}', 'line 1: u_length_scale: expected 1 numbers'),
    ],
)
def test_what_is_wrong_in_a_csv_is_located(tmp_path, text, message):
    file = tmp_path / 'd.csv'
    file.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_direct_csv(file, some_machine())


@pytest.mark.parametrize(
    'said', ['Point X = 0,0.1,-0.05', 'point x: ,0.1,-0.05', 'POINT X:0,0.1,-0.05']
)
def test_where_it_was_measured_is_read_in_any_spelling_of_the_line(tmp_path, said):
    (tmp_path / 'd.csv').write_text(small_csv().replace('point X: 0,0.1,-0.05', said))
    found = read_direct_csv(tmp_path / 'd.csv', some_machine())
    assert found.axes['X'].point[1:].tolist() == [0.1, -0.05]


def test_what_is_assumed_is_said_and_what_cannot_be_is_refused(tmp_path):
    file = tmp_path / 'd.csv'
    file.write_text(
        small_csv('axis,run,direction,position [mm],EX_µm,EA [µrad]').partition('\n')[2]
    )
    assert any('point X' in remark for remark in read_direct_csv(file, some_machine()).remarks)
    for line, wrong in (
        ('# u_length_scale: 0.5', 'ppm'),
        ('# Point X: 0,100,-50', 'mm'),
        ('# target offset: 0,0,-150', 'mm'),
    ):
        file.write_text(f'{line}\n{small_csv().partition(chr(10))[2]}')
        with pytest.raises(ConfigError, match=wrong):
            read_direct_csv(file, some_machine())

# SPDX-License-Identifier: Apache-2.0
"""The certificate of a calibration: what it states, what it leaves blank, two pages of A4."""

import re
import shutil
import subprocess
from dataclasses import replace

import pytest
from core_cells import some_machine
from html_cells import Page, number, unloading

from otf_core.calibration.calibrate import calibrate
from otf_core.errors import ConfigError
from otf_core.model.machine import machine_from_dict
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.sections import CERTIFICATE, INSTRUMENT, NUMBERS, TEXTS, Circumstances, Limits
from otf_core.reports.calibration import write_calibration
from otf_core.reports.calibration_page import certificate_page

LIMITS = {'volumetric_error': 1e-3, 'uncertainty': 1e-4, 'EXX': 2e-6, 'C0Y': 1e-3}
IN_RANGE = {key: max(20.5, low) for key, (_, _, low, _) in NUMBERS.items()}
FULL = Circumstances(
    dict.fromkeys(INSTRUMENT, 'AT960, of hall 3 and 750123'),
    {
        **dict.fromkeys(TEXTS, 'A. Miller and others'),
        **IN_RANGE,
    },
    dict.fromkeys(CERTIFICATE, 'Example Works Ltd., Example Street 3'),
)
BROWSER = shutil.which('chromium') or shutil.which('chromium-browser')


@pytest.fixture(scope='module')
def plain(cell):
    machine = replace(cell.machine, limits=Limits(LIMITS))
    return calibrate(cell.recording.measured(cell.truth), cell.path, machine)


def with_stated(result, stated):
    machine = replace(result.tables.machine, stated=stated)
    return replace(result, tables=replace(result.tables, machine=machine)).to_dict()


@pytest.fixture(scope='module')
def source(plain):
    stated = Circumstances(
        {'model': 'AT960', 'serial': '750123', 'calibrated': '2026-03-01'},
        {'operator': 'A. Miller', 'place': 'hall 3', 'air_temperature_celsius': 20.4},
        {'number': '2026-0117', 'customer': 'Example <Works>', 'laboratory': 'Metrology North'},
    )
    return certificate_page(with_stated(plain, stated))


def test_a_certificate_states_who_what_where_and_how_sure(source, plain):
    page = Page(source)
    assert page.faults == [] and unloading(source) == []
    for said in (
        'Calibration certificate 2026-0117', 'customer Example <Works>', 'operator A. Miller',
        'place hall 3', 'issued by Metrology North', 'model AT960', 'serial number 750123',
        'air temperature 20.4 °C', 'measurement: good', 'machine: 1 of 4 limits broken',
        'Volume before and after compensation', 'predicted, not measured', 'JCGM 100',
        'coverage factor k = 2', 'about 95 %', 'ISO 14253-1', f'Run {plain.run_id}',
        plain.origin[0].sha256[:16], 'Date', 'Measured by', 'Approved by',
    ):  # fmt: skip
        assert said in page.text, said
    assert '@top-left { content: "certificate 2026-0117, small, run ' in source


def test_all_21_errors_stand_in_it_with_u_limit_and_state(source, plain):
    rows = {row[0]: row for row in Page(source).rows('All 21 errors') if row[0] != 'volume'}
    rows = {name.rstrip('*'): row for name, row in rows.items()}
    assert list(rows) == [*MOTIONS, *SQUARENESS]
    starred = {row[0][:-1] for row in rows.values() if row[0].endswith('*')}
    assert starred == set(plain.offset_bound.contains) != set()
    for name, one in plain.to_dict()['sizes'].items():
        row = rows[name]
        if one['size'] is None:
            assert row[2:4] == ['not known', '']
            continue
        value = one['size'] if name in MOTIONS else plain.tables.squareness[name].value
        wide = 1e6 * one['k'] * one['u']
        assert number(row[2]) == pytest.approx(1e6 * value, abs=0.051 * wide)
        assert number(row[3]) == pytest.approx(wide, rel=0.051)
    assert rows['EXX'][5:] == ['2', 'fail']
    assert rows['C0Y'][5:] == ['1000', 'pass']
    volume = [row for row in Page(source).rows('All 21 errors') if row[0] == 'volume']
    assert [row[6] for row in volume] == ['pass', 'pass']


def test_what_nobody_stated_is_left_to_be_filled_in_by_hand(plain):
    page = Page(certificate_page(with_stated(plain, Circumstances())))
    assert page.text.count('…' * 10) == 5
    assert 'model not stated' in page.text


@pytest.mark.skipif(BROWSER is None, reason='no browser prints here')
@pytest.mark.parametrize('stated', [Circumstances(), FULL], ids=['bare', 'full'])
def test_a_certificate_prints_on_two_pages(plain, stated, tmp_path):
    (tmp_path / 'certificate.html').write_text(certificate_page(with_stated(plain, stated)))
    subprocess.run(
        [BROWSER, '--headless', '--no-sandbox', '--disable-gpu', '--no-pdf-header-footer',
         f'--user-data-dir={tmp_path / "profile"}', f'--print-to-pdf={tmp_path / "out.pdf"}',
         (tmp_path / 'certificate.html').as_uri()],
        check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    assert len(re.findall(rb'/Type ?/Page\b', (tmp_path / 'out.pdf').read_bytes())) == 2


def test_it_is_written_where_machine_yaml_has_its_section(plain, tmp_path):
    write_calibration(plain, tmp_path / 'without')
    machine = replace(plain.tables.machine, stated=FULL)
    stated = replace(plain, tables=replace(plain.tables, machine=machine))
    files = write_calibration(stated, tmp_path / 'with')
    assert not (tmp_path / 'without' / 'certificate.html').exists()
    assert tmp_path / 'with' / 'certificate.html' in files


def test_the_section_of_machine_yaml_is_read_strictly_and_kept():
    data = some_machine().to_dict()
    named = dict.fromkeys(CERTIFICATE, 'x')
    machine = machine_from_dict({**data, 'certificate': named})
    assert machine.stated.certificate == named
    assert machine.to_dict()['certificate'] == named
    with pytest.raises(ConfigError, match=r'certificate.*custommer|custommer.*certificate'):
        machine_from_dict({**data, 'certificate': {'custommer': 'x'}})
    with pytest.raises(ConfigError, match='number'):
        machine_from_dict({**data, 'certificate': {'number': 17}})

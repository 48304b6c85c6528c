# SPDX-License-Identifier: Apache-2.0
"""Files as people have them: right, or refused with the mend; see cases/README.md."""

import csv
import gzip
import re
import shlex
import shutil

import numpy as np
import pytest
from command import HERE, otf, read

CASES = HERE / 'cases'
CHOOSE = '--columns'
TABLES = {
    'bag-empty-path-at-the-end': 'points',
    'columns-command-before-actual': CHOOSE,
    'columns-nominal-before-measured': CHOOSE,
    'columns-nominal-in-brackets': CHOOSE,
    'columns-rotation-before-position': CHOOSE,
    'columns-sec-nanosec': '',
    'columns-secs-nsecs': '',
    'dates-day-first-over-midnight': '--time-format|day',
    'dates-two-digit-year-first': '--time-format|--columns',
    'index-taken-for-time': '--rate',
    'path-excel-na-lost': 'line 6',
    'path-is-nc-program': 'NC program',
    'quoted-decimal-comma-samples': 'comma',
    'sa-export-columns-with-dash': '',
    'sa-export-names-and-axes-line': CHOOSE,
    'samples-excel-na-uncounted': '1805',
    'stamps-lost-zeros-ns': 'timestamp|time',
    'thousands-english': 'thousands',
    'time-asctime-comma': 'have 5|5 columns|comma',
    'time-utc-word': 'UTC|--time-format',
}
"""What a refusal has to say; empty: it has to be read."""
LIMIT = {'thousands-english': 1.5}
"""u that the tables may be off where it is not one: reference of another machine file."""
POINTS = {
    'head-one-name-short': ('3 columns.*4', [[150, 50, -100], [100, 50, -100], [10, 150, -50]]),
    'points-excel-na-lost': ('line 3', None),
    'points-first-line-lost': ('line 2', [[1000.5, 0, 0], None, None]),
    'points-first-line-na-lost': ('line 2', None),
    'quoted-decimal-comma': (
        'comma|quote',
        [[150.25, 0.5, -100.5], [150.25, 0.25, -50.5], [200.5, 0.25, -50.5]],
    ),
}
"""What a refusal has to say, and the points in mm that may be answered instead (None: any)."""


def laid_out(name, folder):
    """The case in a folder, unpacked, with the files that cases share; and its command."""
    for source in (CASES / 'shared', CASES / name):
        shutil.copytree(source, folder, dirs_exist_ok=True)
    for packed in folder.rglob('*.gz'):
        packed.with_suffix('').write_bytes(gzip.decompress(packed.read_bytes()))
        packed.unlink()
    return shlex.split((folder / 'command.txt').read_text())[1:]


def worst(folder):
    """Largest departure of the tables from the reference, in u of the reference."""
    document, ratios = read(folder / 'out/error_tables.json'), []
    with open(folder / 'reference_tables.csv', newline='') as file:
        for row in csv.DictReader(file):
            if own := document['motions'].get(row['motion']):
                found = np.interp(float(row['position']), own['position'], own['value'])
            else:
                found = document['squareness'][row['motion']]['value']
            ratios.append(abs(found - float(row['value'])) / (float(row['u']) + 1e-9))
    return max(ratios)


def test_every_case_is_tried():
    folders = {path.name for path in CASES.iterdir() if path.is_dir()} - {'shared'}
    others = {'bag-ros1-in-mcap', 'bag-sqlite-empty-storage-id', 'lattice-errors-in-um'}
    assert folders == {*TABLES, *POINTS, *others}
    assert len(folders) == 28


@pytest.mark.parametrize('name', TABLES)
def test_recording_gives_the_tables_of_a_clean_export_or_the_mend(tmp_path, name):
    done = otf(*laid_out(name, tmp_path), folder=tmp_path)
    if done.code in (0, 4, 5):
        assert worst(tmp_path) < LIMIT.get(name, 1.0), done.said
        if name.startswith('dates-two'):
            assert '2026-01-31' in (tmp_path / 'out/error_tables.json').read_text()
        return
    assert TABLES[name], done.said
    assert re.search(TABLES[name], done.said), done.said
    assert not (tmp_path / 'out').exists()


def test_stated_form_of_the_times_reads_what_was_refused(tmp_path):
    words = laid_out('dates-two-digit-year-first', tmp_path)
    done = otf(*words, '--time-format', '%y-%m-%d %H:%M:%S.%f', folder=tmp_path)
    assert done.code in (0, 4, 5) and worst(tmp_path) < 1.0, done.said
    assert '2026-01-31' in (tmp_path / 'out/error_tables.json').read_text()


@pytest.mark.parametrize('name', POINTS)
def test_every_point_is_answered_or_its_line_is_named(tmp_path, name):
    words, points = POINTS[name]
    done = otf(*laid_out(name, tmp_path), folder=tmp_path)
    if done.code:
        assert re.search(words, done.said), done.said
        assert not (tmp_path / 'errors.csv').exists()
        return
    assert points, done.said
    rows = [r.split(',') for r in (tmp_path / 'errors.csv').read_text().splitlines()[1:]]
    assert len(rows) == len(points)
    for row, point in zip(rows, points, strict=True):
        if point:
            np.testing.assert_allclose(np.array(row[:3], float), np.array(point) / 1e3, atol=1e-9)


def test_bag_of_ros_1_is_named_with_what_converts_it(tmp_path):
    done = otf(*laid_out('bag-ros1-in-mcap', tmp_path), folder=tmp_path)
    assert done.code == 0 or ('ROS 1' in done.said and 'rosbags-convert' in done.said)


def test_bag_without_the_name_of_its_storage_is_read_or_the_key_is_named(tmp_path):
    done = otf(*laid_out('bag-sqlite-empty-storage-id', tmp_path), folder=tmp_path)
    assert done.code == 0 or 'storage_identifier' in done.said


def test_lattice_in_micrometres_is_refused_with_the_unit(tmp_path):
    done = otf(*laid_out('lattice-errors-in-um', tmp_path), folder=tmp_path)
    assert done.code in (2, 3)
    assert re.search('um|µm', done.said)
    assert not (tmp_path / 'out').exists()

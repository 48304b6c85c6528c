# SPDX-License-Identifier: Apache-2.0
"""A full disk: the tables are there, the manifest names what is not."""

import errno
import json
import os

import pytest

from otf_core.errors import ConfigError
from otf_core.files.output_folder import MANIFEST, OutputFolder
from otf_core.files.writing import DiskFull, write_if_it_fits, write_text

SMALL, LARGE = 'tables', 'residuals' * 100


@pytest.fixture
def little_room(monkeypatch):
    """Files of more than 100 byte do not fit."""
    replace = os.replace

    def full(source, target):
        if os.path.getsize(source) > 100 and not str(target).endswith(MANIFEST):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(source, target)

    monkeypatch.setattr(os, 'replace', full)


def test_files_that_do_not_fit_are_named_in_the_manifest(tmp_path, little_room):
    out = OutputFolder(tmp_path / 'out')
    with out.filled('calibrate') as folder:
        for name, text in (('small', SMALL), ('large', LARGE)):
            write = lambda: write_text(folder / name, text)  # noqa: B023, E731
            assert write_if_it_fits(out.missing, name, write) == (name == 'small')
    manifest = json.loads((tmp_path / 'out' / MANIFEST).read_text())
    assert manifest['missing'] == {'large': 'the disk is full'}
    assert list(manifest['sha256']) == ['small']
    assert sorted(p.name for p in (tmp_path / 'out').iterdir()) == [MANIFEST, 'small']
    assert out.missing_words == 'the disk is full: large not written'


def test_what_may_not_be_missing_is_refused_and_nothing_is_left(tmp_path, little_room):
    out = OutputFolder(tmp_path / 'out')
    with pytest.raises(DiskFull, match='cannot be written'), out.filled('calibrate') as folder:
        write_if_it_fits(None, 'large', lambda: write_text(folder / 'large', LARGE))
    assert not list(tmp_path.iterdir())


def test_another_trouble_is_no_full_disk(tmp_path):
    missing = {}
    with pytest.raises(ConfigError, match='cannot be written'):
        write_if_it_fits(missing, 'x', lambda: write_text(tmp_path / 'none' / 'x', SMALL))
    assert not missing

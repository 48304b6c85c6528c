# SPDX-License-Identifier: Apache-2.0
"""Where results go: refused before the work, whole or not there, nobody else's files deleted."""

import os
from pathlib import Path

import pytest

from otf_core.errors import ConfigError
from otf_core.files.output_folder import MANIFEST, OutputFile, OutputFolder


def fill(folder, content='first', **options):
    """Write a result of three files, one of them in a folder."""
    with OutputFolder(folder, **options).filled('test') as new:
        (new / 'a.json').write_text(content)
        (new / 'inner').mkdir()
        (new / 'inner' / 'b.csv').write_text(content)


def names(folder):
    return sorted(str(p.relative_to(folder)) for p in Path(folder).rglob('*') if p.is_file())


@pytest.fixture
def out(tmp_path):
    """A name in an empty folder."""
    return tmp_path / 'top' / 'out'


def test_overwriting_replaces_all_and_leaves_nothing_of_before(out):
    fill(out)
    with OutputFolder(out, overwrite=True).filled('test') as new:
        (new / 'c.txt').write_text('second')
    assert names(out) == ['c.txt', MANIFEST]
    assert os.listdir(out.parent) == ['out']


@pytest.mark.parametrize('strange', ['notes.txt', 'inner/notes.txt', '.hidden'])
def test_files_of_others_are_never_deleted(out, strange):
    fill(out)
    (out / strange).write_text('mine')
    for overwrite in (False, True):
        with pytest.raises(ConfigError, match=r'notes\.txt|hidden'):
            OutputFolder(out, overwrite=overwrite)
    assert (out / strange).read_text() == 'mine'


def test_results_changed_by_hand_are_no_longer_ours(out):
    fill(out)
    (out / 'inner' / 'b.csv').write_text('corrected by hand')
    with pytest.raises(ConfigError, match=r'inner/b\.csv'):
        OutputFolder(out, overwrite=True)


def test_link_to_a_folder_is_followed_and_stays(out, tmp_path):
    out.mkdir(parents=True)
    (tmp_path / 'link').symlink_to(out)
    fill(tmp_path / 'link')
    fill(tmp_path / 'link', 'second', overwrite=True)
    assert (tmp_path / 'link').is_symlink()
    assert (out / 'a.json').read_text() == 'second'


@pytest.mark.parametrize(
    ('name', 'words'),
    [
        ('file', 'is a file'),
        ('file/below', 'is a file'),
        ('file/below/more', 'is a file'),
        ('x' * 300, 'too long'),
        ('nul\0', 'null'),
    ],
)
def test_name_that_cannot_be_a_folder_is_refused_at_once(tmp_path, name, words):
    (tmp_path / 'file').write_text('')
    with pytest.raises(ConfigError, match=words):
        OutputFolder(f'{tmp_path}/{name}')
    assert os.listdir(tmp_path) == ['file']


def test_input_is_not_replaced_by_results_of_it(out):
    fill(out)
    for source in (out, out / 'inner', out / 'a.json'):
        with pytest.raises(ConfigError, match='holds the input'):
            OutputFolder(out, overwrite=True, inputs=[source])


def test_failure_leaves_what_was_there_and_nothing_else(out):
    fill(out)
    with (
        pytest.raises(RuntimeError, match='half way'),
        OutputFolder(out, overwrite=True).filled('test') as new,
    ):
        (new / 'a.json').write_text('half of the n')
        raise RuntimeError('half way')
    assert (out / 'a.json').read_text() == 'first'
    assert os.listdir(out.parent) == ['out']


def test_folder_filled_meanwhile_is_not_mixed(out):
    target = OutputFolder(out)
    fill(out)
    with pytest.raises(ConfigError, match='holds files already'), target.filled('test') as new:
        (new / 'a.json').write_text('second')
    assert (out / 'a.json').read_text() == 'first'


def test_single_file_is_refused_replaced_or_kept(tmp_path):
    file = tmp_path / 'below' / 'e.csv'

    def ours(path):
        return path.read_text().startswith('ours')

    with OutputFile(file, ours).filled() as partial:
        partial.write_text('ours, 1')
    with pytest.raises(ConfigError, match='exists already'):
        OutputFile(file, ours)
    with OutputFile(file, ours, overwrite=True).filled() as partial:
        partial.write_text('ours, 2')
    assert file.read_text() == 'ours, 2'
    assert os.listdir(file.parent) == ['e.csv']
    file.write_text('theirs')
    with pytest.raises(ConfigError, match='not a result'):
        OutputFile(file, ours, overwrite=True)
    for name, words in ((tmp_path, 'is a folder'), (file / 'x', 'is a file')):
        with pytest.raises(ConfigError, match=words):
            OutputFile(name, ours)
    with pytest.raises(ConfigError, match='input'):
        OutputFile(file, lambda path: True, overwrite=True, inputs=[file])

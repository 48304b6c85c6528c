# SPDX-License-Identifier: Apache-2.0
"""Where results go: refused before the work, whole or not there, nobody else's files deleted."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import otf_core
from otf_core.errors import ConfigError
from otf_core.files.output_folder import MANIFEST, OutputFile, OutputFolder, foreign_files


def fill(folder, content='first', **options):
    """Write a result of three files, one of them in a folder."""
    with OutputFolder(folder, **options).filled('test') as new:
        (new / 'a.json').write_text(content)
        (new / 'inner').mkdir()
        (new / 'inner' / 'b.csv').write_text(content)


def names(folder):
    return sorted(str(p.relative_to(folder)) for p in Path(folder).rglob('*') if p.is_file())


WHOLE = ['a.json', 'inner/b.csv', MANIFEST]


@pytest.fixture
def out(tmp_path):
    """A name in an empty folder."""
    return tmp_path / 'top' / 'out'


def test_new_folder_is_made_with_those_above_it(out):
    fill(out)
    assert names(out) == WHOLE
    assert os.listdir(out.parent) == ['out']


def test_folder_with_results_is_refused_at_once_and_kept(out):
    fill(out)
    with pytest.raises(ConfigError, match=r'out: holds files already; .* --overwrite'):
        OutputFolder(out)
    assert (out / 'a.json').read_text() == 'first'


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


def test_link_inside_a_folder_is_no_result(out, tmp_path):
    fill(out)
    (out / 'latest').symlink_to(tmp_path)
    assert foreign_files(out) == [out / 'latest']


def test_folder_of_others_is_refused_with_overwrite_too(tmp_path):
    (tmp_path / 'thesis.tex').write_text('years of work')
    with pytest.raises(ConfigError, match=r'thesis\.tex'):
        OutputFolder(tmp_path, overwrite=True)


def test_manifest_that_lists_nothing_makes_nothing_ours(out):
    out.mkdir(parents=True)
    (out / MANIFEST).write_text('{"schema": "otf-manifest/1", "sha256": "all"}')
    (out / 'a.json').write_text('mine')
    assert foreign_files(out) == [out / MANIFEST, out / 'a.json']


def test_empty_folder_is_filled_and_keeps_its_mode(out):
    out.mkdir(parents=True)
    out.chmod(0o750)
    fill(out)
    assert names(out) == WHOLE
    assert out.stat().st_mode & 0o777 == 0o750


def test_folder_that_one_stands_in_stays_the_same_folder(out, monkeypatch):
    out.mkdir(parents=True)
    monkeypatch.chdir(out)
    before = out.stat().st_ino
    fill('.')
    fill('.', 'second', overwrite=True)
    assert out.stat().st_ino == before == Path.cwd().stat().st_ino
    assert sorted(os.listdir()) == ['a.json', 'inner', MANIFEST]
    assert Path('a.json').read_text() == 'second'


def test_link_to_a_folder_is_followed_and_stays(out, tmp_path):
    out.mkdir(parents=True)
    (tmp_path / 'link').symlink_to(out)
    fill(tmp_path / 'link')
    fill(tmp_path / 'link', 'second', overwrite=True)
    assert (tmp_path / 'link').is_symlink()
    assert (out / 'a.json').read_text() == 'second'


def test_link_to_nothing_is_said(tmp_path):
    (tmp_path / 'link').symlink_to(tmp_path / 'nowhere')
    with pytest.raises(ConfigError, match=r'link: is a link to .*nowhere, which does not exist'):
        OutputFolder(tmp_path / 'link')


@pytest.mark.parametrize(
    ('name', 'words'),
    [
        ('file', 'is a file'),
        ('file/below', 'is a file'),
        ('file/below/more', 'is a file'),
        ('x' * 300, 'File name too long'),
        ('nul\0', 'null'),
    ],
)
def test_name_that_cannot_be_a_folder_is_refused_at_once(tmp_path, name, words):
    (tmp_path / 'file').write_text('')
    with pytest.raises(ConfigError, match=words):
        OutputFolder(f'{tmp_path}/{name}')
    assert os.listdir(tmp_path) == ['file']


@pytest.mark.skipif(os.geteuid() == 0, reason='root may write everywhere')
def test_folder_without_permission_is_refused_at_once(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(ConfigError, match='Permission denied'):
        OutputFolder(tmp_path / 'out')


def test_device_or_kernel_folder_is_refused_at_once():
    with pytest.raises(ConfigError, match='cannot be written'):
        OutputFolder('/proc/otf')


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


SLOW = """
import signal, sys, time
from otf_core.files.output_folder import OutputFolder
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where jobs run behind
with OutputFolder(sys.argv[1]).filled('test') as new:
    (new / 'a.json').write_text('half')
    print('begun', flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_killed_command_leaves_nothing_under_the_final_name(out, number):
    source = Path(next(iter(otf_core.__path__))).parent
    child = subprocess.Popen(
        [sys.executable, '-c', SLOW, str(out)],
        env={**os.environ, 'PYTHONPATH': str(source)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    with child:
        assert child.stdout.readline() == b'begun\n'
        child.send_signal(number)
    assert child.returncode != 0
    assert not out.exists()
    fill(out)
    assert names(out) == WHOLE


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
    with pytest.raises(ConfigError, match='not a result of this command'):
        OutputFile(file, ours, overwrite=True)
    for name, words in ((tmp_path, 'is a folder'), (file / 'x', 'is a file')):
        with pytest.raises(ConfigError, match=words):
            OutputFile(name, ours)
    with pytest.raises(ConfigError, match='input'):
        OutputFile(file, lambda path: True, overwrite=True, inputs=[file])

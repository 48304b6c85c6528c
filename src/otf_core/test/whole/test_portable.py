# SPDX-License-Identifier: Apache-2.0
"""What Windows and macOS lack or do otherwise, as far as it can be tried on Linux."""

import ast
import errno
import mmap
import os
import subprocess
import sys
from pathlib import Path

from bag_cells import assert_same

import otf_core
from otf_core.bags.bag import read_bag
from otf_core.files.output_folder import OutputFolder
from otf_core.files.writing import write_text

ROOT = Path(otf_core.__file__).parent
POSIX_ONLY = {'fcntl', 'pwd', 'grp', 'resource', 'termios', 'tty', 'pty', 'syslog'}
LINUX = ('bags/journal.py',)
"""Of the nodes, which run on Linux only."""
POSIX_CALLS = {'fork', 'getuid', 'geteuid', 'getgid', 'killpg', 'chown', 'mkfifo', 'madvise'}
GUARDED = {'madvise', 'geteuid'}
"""Called only where they exist."""
TEXTS = {
    f: f.read_text(encoding='utf-8')
    for f in sorted(ROOT.rglob('*.py'))
    if f.relative_to(ROOT).as_posix() not in LINUX
}
TREES = {f: ast.parse(text) for f, text in TEXTS.items()}


def calls(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield node, getattr(node.func, 'attr', getattr(node.func, 'id', ''))


def test_no_module_is_imported_that_other_systems_lack():
    for file, tree in TREES.items():
        names = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module)
        assert not names & POSIX_ONLY, file


def test_no_function_is_called_that_other_systems_lack():
    for file, tree in TREES.items():
        for _, name in calls(tree):
            guarded = name in GUARDED and 'hasattr(' in TEXTS[file]
            assert name not in POSIX_CALLS or guarded, file


ELSEWHERE = """
import importlib, os, signal, sys
import numpy, scipy.linalg, scipy.special, scipy.sparse.linalg, scipy.optimize, scipy.signal
import scipy.stats, subprocess, tempfile, multiprocessing, asyncio, mcap.reader, rosbags.highlevel
sys.modules.update(dict.fromkeys(sys.argv[1].split()))
for name in 'fork getuid geteuid killpg wait4 chown mkfifo nice uname sysconf statvfs'.split():
    delattr(os, name)
for name in 'SIGKILL SIGHUP SIGALRM SIGQUIT pause alarm'.split():
    delattr(signal, name)
for module in sys.argv[2].split():
    importlib.import_module(module)
from otf_core.cli import main
sys.exit(main(sys.argv[3:]))
"""
"""Imports modules and runs a command where the packages are there and POSIX is not."""


def test_all_but_the_journal_is_imported_without_posix():
    parts = [f.relative_to(ROOT.parent).with_suffix('').parts for f in TREES]
    modules = ['.'.join(p).removesuffix('.__init__') for p in parts if p[-1] != '__main__']
    assert len(modules) > 200
    machine = ROOT.parents[2] / 'bags/y-carries-the-table/machine.yaml'
    command = [sys.executable, '-c', ELSEWHERE, ' '.join(POSIX_ONLY), ' '.join(modules)]
    command += ['info', str(machine)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not done.stderr


def test_every_text_is_opened_with_its_encoding():
    for file, tree in TREES.items():
        for node, name in calls(tree):
            if name not in ('open', 'read_text', 'write_text', 'NamedTemporaryFile'):
                continue
            if (
                isinstance(node.func, ast.Attribute)
                and name == 'write_text'
                and len(node.args) > 1
            ):
                continue
            if isinstance(node.func, ast.Name) and name == 'write_text':
                continue  # files.writing.write_text
            if getattr(getattr(node.func, 'value', None), 'id', '') == 'os':
                continue
            words = {k.arg for k in node.keywords}
            modes = [a.value for a in node.args if isinstance(a, ast.Constant)]
            binary = any('b' in str(m) and set(str(m)) <= set('rwxab+') for m in modes)
            assert binary or 'encoding' in words, f'{file}, line {node.lineno}'


def test_texts_have_the_same_bytes_everywhere(tmp_path):
    source = (ROOT / 'files/writing.py').read_text(encoding='utf-8')
    assert "newline='\\n'" in source
    write_text(tmp_path / 'a.csv', 'x,y\nµ,1\n')
    assert (tmp_path / 'a.csv').read_bytes() == b'x,y\n\xc2\xb5,1\n'


def test_a_bag_is_read_without_advice_to_the_memory(bag, monkeypatch):
    monkeypatch.delattr(mmap, 'MADV_DONTNEED')
    assert_same(read_bag(bag))


def test_a_folder_is_filled_where_rename_refuses_what_exists(tmp_path, monkeypatch):
    rename = os.rename

    def as_on_windows(source, target):
        if os.path.exists(target):
            raise FileExistsError(errno.EEXIST, 'exists', str(target))
        rename(source, target)

    monkeypatch.setattr(os, 'rename', as_on_windows)
    (tmp_path / 'out').mkdir()
    for content in ('first', 'second'):
        with OutputFolder(tmp_path / 'out', overwrite=True).filled('test') as folder:
            write_text(folder / 'sub.txt', content)
        assert (tmp_path / 'out/sub.txt').read_text(encoding='utf-8') == content


def test_a_console_that_cannot_show_a_letter_ends_nothing(tmp_path):
    name = tmp_path / 'größe µ.csv'
    name.write_text('x,y,z,dx,dy,dz\n0,0,0,0,0,0\n', encoding='utf-8')
    command = [sys.executable, '-m', 'otf_core.cli', 'info', str(name)]
    env = {**os.environ, 'PYTHONIOENCODING': 'ascii', 'PYTHONUTF8': '0'}
    done = subprocess.run(command, capture_output=True, env=env, check=False)
    assert done.returncode == 0 and b'1 points' in done.stdout


def test_no_encoding_is_left_to_the_system():
    bag = ROOT.parents[2] / 'bags/x-and-y-carry-the-table/bag'
    command = [sys.executable, '-X', 'warn_default_encoding', '-W', 'error::EncodingWarning']
    command += ['-m', 'otf_core.cli', 'check', str(bag)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not done.stderr

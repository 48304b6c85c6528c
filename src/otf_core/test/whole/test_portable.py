# SPDX-License-Identifier: Apache-2.0
"""What Windows and macOS lack or do otherwise, as far as it can be tried on Linux."""

import ast
import errno
import os
import subprocess
import sys
from pathlib import Path

import otf_core
from otf_core.files.output_folder import OutputFolder
from otf_core.files.writing import write_text

ROOT = Path(otf_core.__file__).parent
POSIX_ONLY = {'fcntl', 'pwd', 'grp', 'resource', 'termios', 'tty', 'pty', 'syslog'}
LINUX = ('bags/journal.py',)
"""Of the nodes, which run on Linux only."""
TEXTS = {
    f: f.read_text(encoding='utf-8')
    for f in sorted(ROOT.rglob('*.py'))
    if f.relative_to(ROOT).as_posix() not in LINUX
}
TREES = {f: ast.parse(text) for f, text in TEXTS.items()}


def test_no_module_is_imported_that_other_systems_lack():
    for file, tree in TREES.items():
        names = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module)
        assert not names & POSIX_ONLY, file


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


def test_no_encoding_is_left_to_the_system():
    bag = ROOT.parents[2] / 'bags/x-and-y-carry-the-table/bag'
    command = [sys.executable, '-X', 'warn_default_encoding', '-W', 'error::EncodingWarning']
    command += ['-m', 'otf_core.cli', 'check', str(bag)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not done.stderr

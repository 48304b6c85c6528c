# SPDX-License-Identifier: Apache-2.0
"""Where things lie, and the quick check that nothing is missing; runs on Python 3.8."""

import os
import sys

ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
VENV = os.path.join(ROOT, '.venv')
PYTHON = os.path.join(VENV, 'bin', 'python')
CORE_STAMP = os.path.join(VENV, 'core.stamp')
SUPPORTED = ((3, 10), (3, 13))


class SetupError(Exception):
    """The set-up cannot go on; the message says why and what to do."""


def complain(message, code):
    print(f'otf: {message}', file=sys.stderr)
    return code


def build_root():
    """ROOT, or a folder in /tmp with links to it if ROS' CMake files choke on its name."""
    if ROOT.isascii() and all(c.isalnum() or c in '_./+@-' for c in ROOT):
        return ROOT
    import zlib

    folder = f'/tmp/otf-{os.getuid()}-{zlib.crc32(os.fsencode(ROOT)):08x}'
    os.makedirs(folder, mode=0o700, exist_ok=True)
    if os.path.islink(folder) or os.stat(folder).st_uid != os.getuid():
        raise SetupError(f'{folder} is in the way: please remove it')
    for name in ('.venv', 'src'):
        link = os.path.join(folder, name)
        if not os.path.islink(link):
            os.symlink(os.path.join(ROOT, name), link)
    return folder


def python_trouble():
    """Why this Python cannot be used, or an empty string."""
    low, high = SUPPORTED
    if low <= sys.version_info[:2] <= high:
        return ''
    import shutil

    names = [f'python3.{minor}' for minor in range(high[1], low[1] - 1, -1)]
    found = next((name for name in names if shutil.which(name)), None)
    advice = f'run {found} {sys.argv[0]} ...' if found else 'install one of ' + ', '.join(names)
    version = '.'.join(map(str, sys.version_info[:3]))
    return f'needs Python 3.10-3.13, this is {version}; {advice}'


def requirements(*names):
    """Text of the requirement files, in the order given."""
    texts = []
    for name in names:
        with open(os.path.join(ROOT, 'requirements', name + '.txt'), encoding='utf-8') as file:
            texts.append(file.read())
    return ''.join(texts)


def core_key():
    """What the core's environment was made from; it is made anew when this changes."""
    return '\n'.join([ROOT, os.path.realpath(PYTHON), requirements('core', 'constraints')])


def core_ready():
    """Whether .venv holds the core requirements."""
    try:
        with open(CORE_STAMP, encoding='utf-8') as file:
            stamp = file.read()
    except OSError:
        return False
    return stamp == core_key() and os.access(PYTHON, os.X_OK)


def core_environment(*packages):
    """The caller's variables with the core, these packages, and nothing else on Python's path.

    Bytecode is kept beside the sources, whatever the caller has set: compiling them anew would
    cost every command up to 0.5 s.
    """
    dropped = ('PYTHONHOME', 'PYTHONDONTWRITEBYTECODE')
    kept = {name: value for name, value in os.environ.items() if name not in dropped}
    return {
        **kept,
        'PYTHONPATH': os.pathsep.join(
            os.path.join(ROOT, 'src', package) for package in ('otf_core', *packages)
        ),
        'PYTHONSAFEPATH': '1',
    }


def exec_core(arguments, *packages, python=PYTHON):
    os.execve(python, [python, *arguments], core_environment(*packages))

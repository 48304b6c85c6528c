# SPDX-License-Identifier: Apache-2.0
"""What the doctor says of installations that something is wrong with."""

import json
import re
import subprocess
import sys
from pathlib import Path

from cli_cells import run

from otf_core.cli import doctor
from otf_core.cli.doctor import ERROR

ROOT = Path(__file__).resolve().parents[3]


def of(check, part):
    return next(state for state in check() if state.part == part)


def test_this_installation_can_calibrate(capsys):
    assert run('doctor', '--json') == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer['healthy'] is True
    assert {p['part'] for p in answer['parts']} == {'python', 'packages', 'disk', 'ros'}


def test_what_is_needed_is_what_the_package_requires():
    lines = (ROOT / 'src/otf_core/setup.cfg').read_text(encoding='utf-8')
    required = dict(re.findall(r'^ +([\w-]+)>=([\d.]+)$', lines, re.MULTILINE))
    assert required == doctor.OLDEST_VERSIONS


def test_a_package_that_is_missing_or_old_is_named(monkeypatch):
    have = {'numpy': '1.20.3', 'mcap': None}

    def version(name):
        if have.get(name, '99') is None:
            raise doctor.PackageNotFoundError(name)
        return have.get(name, '99')

    monkeypatch.setattr(doctor, 'version', version)
    _, missing, old = doctor.check_versions()
    assert (missing.severity, missing.what) == (ERROR, 'missing: mcap')
    assert old.what == 'too old: numpy 1.20.3 (needed 1.26)' and old.do


def test_the_doctor_needs_no_numpy():
    code = (
        'import sys; sys.modules["numpy"] = None; '
        'from otf_core.cli import main; sys.exit(main(["doctor"]))'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and done.stderr == ''

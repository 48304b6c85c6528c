# SPDX-License-Identifier: Apache-2.0
"""What is installed, looked at from outside: pinned content, known weaknesses (``.ci/audit``).

Every requirement is resolved as set-up does; each archive has to be listed with its SHA-256.
pip-audit asks for known weaknesses of the pinned versions, where its database answers.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import hashes

ROOT = Path(__file__).resolve().parents[1]
FILES = ('core', 'dev', 'ros')
PINS = ROOT / 'requirements' / 'constraints.txt'
ANSWERS_WITHIN = 300.0
"""s"""


def main() -> int:
    """Print what was found; 1 if anything is wrong, 0 also where nobody could be asked."""
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        subprocess.run([sys.executable, '-m', 'venv', home], check=True)
        python = home / 'bin/python'
        subprocess.run([python, '-m', 'pip', 'install', '--quiet', 'pip-audit'], check=True)
        wrong = [text for file in FILES for text in content(python, home, file)]
        wrong += weaknesses(python, home)
    print('\n'.join(wrong) or 'audit: nothing found')
    return 1 if wrong else 0


def content(python: Path, home: Path, file: str) -> list[str]:
    """Resolve the requirements of a file; say which archives are not what was pinned."""
    report = home / f'{file}.json'
    command = [python, '-m', 'pip', 'install', '--dry-run', '--ignore-installed', '--quiet']
    command += ['--report', report, '-r', ROOT / f'requirements/{file}.txt', '-c', PINS]
    subprocess.run(command, check=True)
    count, new = len(hashes.archives(report)), hashes.unlisted(report)
    print(f'requirements/{file}.txt: {count} archives, {count - len(new)} with a pinned hash')
    wrong = [f'{name}: another content than the one pinned' for name in hashes.changed(report)]
    return wrong + [f'{name}: not in requirements/hashes.txt' for name in new]


def weaknesses(python: Path, home: Path) -> list[str]:
    """Ask for known weaknesses of all pinned versions; say it where nobody answers."""
    answer = home / 'audit.json'
    command = [python, '-m', 'pip_audit', '-r', PINS, '--no-deps', '--disable-pip', '--format']
    command += ['json', '--output', answer, '--progress-spinner', 'off']
    try:
        subprocess.run(command, capture_output=True, text=True, timeout=ANSWERS_WITHIN)
        told = json.loads(answer.read_text())['dependencies']
    except (subprocess.TimeoutExpired, OSError, ValueError) as error:
        print(f'known weaknesses: NOT AUDITED, the database does not answer ({error})')
        return []
    skipped = [one['name'] for one in told if 'skip_reason' in one]
    print(f'known weaknesses: {len(told) - len(skipped)} of {len(told)} packages audited')
    if len(skipped) == len(told):
        print('NOT AUDITED: the index that pip is set to has no database; ask one that has')
    elif skipped:
        print(f'NOT AUDITED, unknown to the database: {", ".join(skipped)}')
    return [
        f'{one["name"]} {one["version"]}: {weak["id"]}, mended in {weak["fix_versions"] or "none"}'
        for one in told
        for weak in one.get('vulns', [])
    ]


if __name__ == '__main__':
    sys.exit(main())

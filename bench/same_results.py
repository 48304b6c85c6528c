# SPDX-License-Identifier: Apache-2.0
"""Does a change leave every result as it was? Two commits, byte for byte or within a share of u.

The commit is laid out beside the repository for the time of the run (``git worktree``); both trees
run the same commands on the recordings of ``bags`` and of ``tests/contract``, with the same words
in the same folder and one date (SOURCE_DATE_EPOCH). Ends with 1 where a file differs, and names
it. Live tables need no run of their own: tests/test_bags.py compares them with offline ones.

With ``--tolerance 0.1`` digits may change: values and u of error tables by a tenth of u (noise and
misfit alone), sizes of causes by their u; exit codes, verdicts, causes, hidden motions and the
choice of reversal are the same. The largest change of every case is printed.

Usage: python bench/same_results.py [COMMIT] [--only CASE,CASE] [--tolerance SHARE]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from common import ROOT, core_on_path, texts

sys.path.append(str(ROOT / 'tests/contract'))
from golden import RECORDINGS, departures, gap_departures, reduced

DATE = '1700000000'


def cases() -> dict[str, list[str]]:
    """Command of every case, without the folder that it writes."""
    cell = ['--machine', str(ROOT / 'src/otf_bringup/config/machine.yaml')]
    found = {
        'plan': ['plan', *cell, '--dialect', 'linuxcnc'],
        'simulate': ['simulate', *cell, '--rate', '50'],
    }
    for name, own in RECORDINGS.items():
        words = [str(word) for word in own.words]
        found[f'{own.verb} {name}'] = words
        if 'recordings' not in str(own.bags[0]):
            found[f'diagnose {name}'] = ['diagnose', *words[1:]]
    found['effects auto'] = [*found['diagnose explained'], '--effects', 'auto']
    found['effects auto'][0] = 'calibrate'
    return found


def command(tree: Path, folder: Path, words: list[str]) -> tuple[int, Path]:
    """Run a command of a tree; its exit code, and the folder it wrote."""
    out = folder / 'out'
    shutil.rmtree(out, ignore_errors=True)
    done = subprocess.run(
        [sys.executable, '-m', 'otf_core.cli', *words, '--out', 'out'],
        cwd=folder, env={**core_on_path(tree), 'SOURCE_DATE_EPOCH': DATE},
        capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode not in (0, 4, 5):  # a result is written with all of them
        lines = '\n'.join(done.stderr.splitlines()[-12:])
        raise SystemExit(f'{" ".join(words)}\nended with {done.returncode}:\n{lines}')
    return done.returncode, out


def hashes(code: int, out: Path) -> dict[str, str]:
    """Exit code, and hashes of all files by their names."""
    files = sorted(path for path in out.rglob('*') if path.is_file())
    found = {str(f.relative_to(out)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}
    return {'exit code': str(code), **found}


def document(code: int, out: Path) -> dict:
    """What is compared within a tolerance: exit code, and tables or gap where there are any."""
    for file in ('gap.json', 'error_tables.json'):
        if (out / file).exists():
            return reduced(code, json.loads((out / file).read_text(encoding='utf-8')))
    return {'exit': code}


def differences(old: dict, new: dict, share: float | None) -> tuple[list[str], str]:
    """What differs between two results of a case, and a remark."""
    if share is None:
        return [f for f in sorted({*old, *new}) if old.get(f) != new.get(f)], f'{len(new)} files'
    if 'causes' in old:
        said, worst = gap_departures(old, new)
    elif 'motions' in old:
        said, worst = departures(old, new, share)
    else:
        said, worst = [f'exit code {new["exit"]}, was {old["exit"]}'] * (old != new), 0.0
    return said, f'{worst:.3f} u'


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('commit', nargs='?', default='HEAD')
    parser.add_argument('--only', type=texts, default=())
    parser.add_argument('--tolerance', type=float, metavar='SHARE', help='of u, e.g. 0.1')
    chosen = parser.parse_args()
    if unknown := set(chosen.only) - set(cases()):
        parser.error(f'--only: {", ".join(unknown)}; possible: {", ".join(cases())}')
    git, differing = ['git', '-C', str(ROOT), 'worktree'], False
    taken = hashes if chosen.tolerance is None else document
    with tempfile.TemporaryDirectory() as name:
        before = Path(name) / 'before'
        add = [*git, 'add', '--quiet', '--detach', str(before), chosen.commit]
        if subprocess.run(add).returncode:
            return 2
        try:
            for case in chosen.only or cases():
                words = cases()[case]
                old, new = (taken(*command(t, Path(name), words)) for t in (before, ROOT))
                said, remark = differences(old, new, chosen.tolerance)
                print(f'{case}: {remark}; {", ".join(said) or "the same"}', flush=True)
                differing = differing or bool(said)
        finally:
            subprocess.run([*git, 'remove', '--force', str(before)], check=True)
    return int(differing)


if __name__ == '__main__':
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""Does a change leave every result as it was? Two commits, byte for byte or within a share of u.

The commit is laid out beside the repository for the time of the run (``git worktree``). It
simulates the recordings once; then both trees run the same commands on them, with the same words
in the same folder and one date (SOURCE_DATE_EPOCH). Ends with 1 where a file differs, and names
it. Live tables need no run of their own: tests/test_bags.py compares them with offline ones bit
for bit.

With ``--tolerance 0.1`` digits may change: values and u of error tables by a tenth of u (noise and
misfit alone), sizes of causes by their u; exit codes, verdicts, causes, hidden motions and the
choice of reversal are the same. The largest change of every case is printed.

Usage: python bench/same_results.py [COMMIT] [--only CASE,CASE] [--tolerance SHARE]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from child import ROOT, core_on_path
from markdown import texts

sys.path.append(str(ROOT / 'tests/contract'))
from golden import RECORDINGS, departures, gap_departures, reduced

BAGS = ('all-axes-carry-the-target', 'y-carries-the-table', 'x-and-y-carry-the-table')
STOPPING = 'x-and-y-carry-the-table'
DATE = '1700000000'
SECOND = 'longer.yaml'

MACHINE = """name: cell-300
chain: w-Y-b-X-Z-t
axes:
  X: {min: 0.0, max: 0.3, table_pitch: 0.1}
  Y: {min: 0.0, max: 0.2, table_pitch: 0.1}
  Z: {min: -0.2, max: 0.0, table_pitch: 0.1}
target_offset: [0.0, 0.0, -0.15]
tracker: {u_range: 0.5e-6, u_angle: 2.0e-6}
"""
EFFECTS = {
    'backlash': '- {effect: backlash, parameters: {B_X: 5.0e-6}}\n',
    'rounded': '- {effect: corner_rounding, parameters: {A: 2.0e-5, l: 0.016}}\n',
}
CHANGED = """
import sys
from dataclasses import replace
import numpy as np
import otf_core
name, out, change = sys.argv[1:]
recording = otf_core.read_bag(name, otf_core.load_machine('machine.yaml'))
samples = recording.samples
xyz = samples.xyz.copy()
if change == 'tracker moves':
    xyz[len(xyz) // 2:] += (40e-6, -25e-6, 15e-6)  # m
else:  # the machine drives inside the circle of its path
    points = np.loadtxt('curved.csv', delimiter=',', skiprows=1)
    recording = replace(recording, path=replace(recording.path, points=points))
otf_core.write_bag(replace(recording, samples=replace(samples, xyz=xyz)), out)
"""
CENTRE, RADIUS, INSIDE = (0.15, 0.1, -0.1), 0.08, 20e-6
"""m; circle beside the lines of the plan, and how far inside it the machine drives."""


def recordings() -> list[list[str]]:
    """Commands that make the recordings, the first of which makes the path that all drive."""
    drive = ['--path', 'plan/plan.json', '--rate', '100']
    plan = ['plan', '--machine', 'machine.yaml', '--out', 'plan']
    made = [plan, ['simulate', '--machine', 'machine.yaml', '--out', 'plain', *drive]]
    truth = ['--tables', 'plain/truth_tables.json']
    for name in EFFECTS:
        own = ['--out', name, '--effects', f'{name}.yaml', '--seed', '3']
        made.append(['simulate', '--machine', 'machine.yaml', *own, *drive, *truth])
    inside = ['--path', 'inside.csv', '--rate', '100', *truth]
    made.append(['simulate', '--machine', 'machine.yaml', '--out', 'inside', *inside])
    return [*made, ['simulate', '--machine', SECOND, '--out', 'longer', *drive, *truth]]


def add_circle(path: str, radius: float) -> str:
    """Path as CSV with two turns of a circle, in chords of 3 degrees, before its last point."""
    x, y, z = CENTRE
    *lines, last = path.splitlines()
    turns = [math.radians(angle) for angle in range(0, 721, 3)]
    circle = [f'{x + radius * math.cos(a):.9f},{y + radius * math.sin(a):.9f},{z}' for a in turns]
    return '\n'.join([*lines, *circle, last, ''])


def cases() -> dict[str, list[str]]:
    """Command of every case, without the folder that it writes."""
    machine = ['--machine', 'machine.yaml']
    found = {'plan': ['plan', *machine, '--dialect', 'linuxcnc']}
    for bag in BAGS:
        own = [f'bags/{bag}/bag', '--machine', f'bags/{bag}/machine.yaml']
        found[f'calibrate {bag}'] = ['calibrate', *own]
        found[f'diagnose {bag}'] = ['diagnose', *own]
        if bag == STOPPING:
            found['standstill'] = ['calibrate', *own, '--method', 'standstill']
    for name in ('plain', 'backlash', 'rounded', 'moved', 'lagging'):
        found[f'calibrate {name}'] = ['calibrate', name, *machine]
        found[f'diagnose {name}'] = ['diagnose', name, *machine]
    found['effects auto'] = ['calibrate', 'rounded', *machine, '--effects', 'auto']
    both = ['plain', 'longer', *machine, '--machine', SECOND]
    found['calibrate two runs'] = ['calibrate', *both]
    found['diagnose two runs'] = ['diagnose', *both]
    return {**found, **stored_cases()}


def stored_cases() -> dict[str, list[str]]:
    """Commands on the recordings of the contract that are not in ``bags``."""
    stored = {name: own for name, own in RECORDINGS.items() if 'recordings' in own.bags[0]}
    return {f'stored {name}': own.words for name, own in stored.items()}


def run(tree: Path, folder: Path, words: list[str], codes: tuple[int, ...] = (0,)) -> int:
    """Run Python of a tree in a folder; SystemExit with its last lines if it fails."""
    environment = {**core_on_path(tree), 'SOURCE_DATE_EPOCH': DATE}
    command = [sys.executable, *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode not in codes:
        lines = '\n'.join((done.stdout + done.stderr).splitlines()[-12:])
        raise SystemExit(f'{" ".join(words)}\nended with {done.returncode}:\n{lines}')
    return done.returncode


def prepare(tree: Path, folder: Path) -> None:
    """Lay out machines, effects and recordings in a folder."""
    (folder / 'bags').symlink_to(ROOT / 'bags')
    (folder / 'machine.yaml').write_text(MACHINE, encoding='utf-8')
    (folder / SECOND).write_text(MACHINE.replace('-0.15]', '-0.25]'), encoding='utf-8')
    for name, text in EFFECTS.items():
        (folder / f'{name}.yaml').write_text(text, encoding='utf-8')
    for words in recordings():
        run(tree, folder, ['-m', 'otf_core.cli', *words])
        if words[0] == 'plan':
            path = (folder / 'plan/path.csv').read_text(encoding='utf-8')
            for name, radius in (('curved', RADIUS), ('inside', RADIUS - INSIDE)):
                text = add_circle(path, radius)
                (folder / f'{name}.csv').write_text(text, encoding='utf-8')
    run(tree, folder, ['-c', CHANGED, 'plain', 'moved', 'tracker moves'])
    run(tree, folder, ['-c', CHANGED, 'inside', 'lagging', 'drives lag'])


def results(tree: Path, folder: Path, words: list[str]) -> dict[str, str]:
    """Hashes of all files that a command writes, by their names, and its exit code."""
    out = folder / 'out'
    gates = (0, 4, 5)  # a result is written with all of them
    code = run(tree, folder, ['-m', 'otf_core.cli', *words, '--out', 'out'], gates)
    files = sorted(path for path in out.rglob('*') if path.is_file())
    found = {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files
    }
    shutil.rmtree(out)
    return {'exit code': str(code), **found}


def document(tree: Path, folder: Path, words: list[str]) -> dict:
    """What is compared within a tolerance: exit code, and tables or gap where there are any."""
    out = folder / 'out'
    code = run(tree, folder, ['-m', 'otf_core.cli', *words, '--out', 'out'], (0, 4, 5))
    found = {'exit': code}
    for file in ('gap.json', 'error_tables.json'):
        if (out / file).exists():
            found = reduced(code, json.loads((out / file).read_text(encoding='utf-8')))
            break
    shutil.rmtree(out)
    return found


def compare_within(before: Path, folder: Path, chosen: list[str], share: float) -> list[str]:
    """Print the largest change of each case, in u; return what departs by more."""
    differing = []
    for name in chosen:
        old, new = (document(tree, folder, cases()[name]) for tree in (before, ROOT))
        if 'causes' in old:
            said, worst = gap_departures(old, new)
        elif 'motions' in old:
            said, worst = departures(old, new, share)
        else:
            said, worst = [f'exit code {new["exit"]}, was {old["exit"]}'] * (old != new), 0.0
        print(f'{name}: {worst:.3f} u{"".join(f"; {word}" for word in said)}', flush=True)
        differing += [f'{name}: {word}' for word in said]
    return differing


def compare(before: Path, folder: Path, chosen: list[str]) -> list[str]:
    """Print a line per case; return what differs."""
    differing = []
    for name in chosen:
        words = cases()[name]
        old, new = (results(tree, folder, words) for tree in (before, ROOT))
        found = [file for file in sorted({*old, *new}) if old.get(file) != new.get(file)]
        print(f'{name}: {len(new) - 1} files, {", ".join(found) or "the same"}', flush=True)
        differing += [f'{name}: {file}' for file in found]
    return differing


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('commit', nargs='?', default='HEAD')
    parser.add_argument('--only', type=texts, default=())
    parser.add_argument('--tolerance', type=float, metavar='SHARE', help='of u, e.g. 0.1')
    chosen = parser.parse_args()
    if unknown := set(chosen.only) - set(cases()):
        parser.error(f'--only: {", ".join(unknown)}; possible: {", ".join(cases())}')
    print(f'working tree against {chosen.commit}')
    git = ['git', '-C', str(ROOT), 'worktree']
    with tempfile.TemporaryDirectory() as name:
        folder, before = Path(name) / 'work', Path(name) / 'before'
        folder.mkdir()
        add = [*git, 'add', '--quiet', '--detach', str(before), chosen.commit]
        if subprocess.run(add).returncode:
            return 2
        try:
            prepare(before, folder)
            names = list(chosen.only or cases())
            if chosen.tolerance is None:
                differing = compare(before, folder, names)
            else:
                differing = compare_within(before, folder, names, chosen.tolerance)
        finally:
            subprocess.run([*git, 'remove', '--force', str(before)], check=True)
    return 1 if differing else 0


if __name__ == '__main__':
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""Is the working tree slower or larger than a commit before? Whole commands of both in turn.

The commit is laid out beside the repository for the time of the run (``git worktree``). Ratios
are working tree over commit: of the shortest wall times, of each pair that ran one after the
other (smallest to largest), and of the peak memory. Ends with 1 where the time of a command or
its memory is above the limit in both the ratio of the smallest and the median of the pairs.

Usage: python bench/regression.py [COMMIT] [--repeats N] [--limit FACTOR] [--only VERB,VERB]
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from child import ROOT, Cost, circumstances, core_on_path, measured
from markdown import heading, row, texts

BAG = ROOT / 'bags/y-carries-the-table'


def commands(scratch: Path) -> dict[str, list[str | Path]]:
    """Words of every command; ``calibrate`` makes the tables that ``predict`` reads."""
    machine, out = ['--machine', BAG / 'machine.yaml'], ['--overwrite', '--out']
    return {
        '--help': ['--help'],
        'calibrate': ['calibrate', BAG / 'bag', *machine, *out, scratch / 'calibrate'],
        'predict': ['predict', '--tables', scratch / 'tables/error_tables.json',
                    '--points', scratch / 'points.csv', *out, scratch / 'predicted.csv'],
        'plan': ['plan', *machine, *out, scratch / 'plan'],
        'diagnose': ['diagnose', BAG / 'bag', *machine, *out, scratch / 'diagnose'],
    }  # fmt: skip


def in_turn(trees: tuple[Path, Path], words: list[str | Path], repeats: int) -> list[list[Cost]]:
    """Costs of a command in both trees, one after the other, ``repeats`` times."""
    line = ['-m', 'otf_core.cli', *words]
    return [[measured(line, core_on_path(tree)) for tree in trees] for _ in range(repeats)]


def judged(pairs: list[list[Cost]], what: str) -> tuple[float, float, list[float]]:
    """Ratio of the smallest, median of the pairs, and all pairs, new over old."""
    old, new = ([getattr(c, what) for c in costs] for costs in zip(*pairs, strict=True))
    ratios = sorted(n / o for o, n in zip(old, new, strict=True))
    return min(new) / min(old), statistics.median(ratios), ratios


def compare(before: Path, scratch: Path, chosen: argparse.Namespace) -> list[str]:
    """Print a row per command; return those above the limit."""
    (scratch / 'points.csv').write_text('x,y,z\n0.1,0.1,-0.1\n', encoding='utf-8')
    every = commands(scratch)
    measured(['-m', 'otf_core.cli', *every['calibrate'][:-1], scratch / 'tables'])
    measured(['-m', 'compileall', '-q', before / 'src', ROOT / 'src/otf_core'])
    print(heading(('command', 's before', 's now', 'ratio', 'of pairs', 'MB now', 'ratio')))
    slower = []
    for name in chosen.only or every:
        pairs = in_turn((before, ROOT), every[name], chosen.repeats)
        wall, peak = judged(pairs, 'wall'), judged(pairs, 'peak')
        shortest = [min(costs[k].wall for costs in pairs) for k in (0, 1)]
        megabytes = min(costs[1].peak for costs in pairs) / 1e6
        print(row((name, *(f'{s:.2f}' for s in shortest), f'{wall[0]:.2f}',
                   f'{wall[2][0]:.2f} to {wall[2][-1]:.2f}', f'{megabytes:.0f}',
                   f'{peak[0]:.2f}')), flush=True)  # fmt: skip
        if any(min(found[:2]) > chosen.limit for found in (wall, peak)):
            slower.append(name)
    return slower


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('commit', nargs='?', default='HEAD~1')
    parser.add_argument('--repeats', type=int, default=5)
    parser.add_argument('--limit', type=float, default=1.3)
    parser.add_argument('--only', type=texts, default=())
    chosen = parser.parse_args()
    if unknown := set(chosen.only) - set(commands(Path())):
        parser.error(f'--only: {", ".join(unknown)}; possible: {", ".join(commands(Path()))}')
    print(f'working tree against {chosen.commit}; {circumstances()}')
    git = ['git', '-C', str(ROOT), 'worktree']
    with tempfile.TemporaryDirectory() as name:
        scratch, before = Path(name), Path(name) / 'before'
        add = [*git, 'add', '--quiet', '--detach', str(before), chosen.commit]
        if subprocess.run(add).returncode:
            return 2
        try:
            slower = compare(before, scratch, chosen)
        finally:
            subprocess.run([*git, 'remove', '--force', str(before)], check=True)
    if slower:
        print(f'above {chosen.limit:g} times the commit before: {", ".join(slower)}')
    return 1 if slower else 0


if __name__ == '__main__':
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""The blind trial: draw and seal cells, diagnose them by the command line, open the key, score.

    ./otf blind --trials 68 --rotary 40 --leave-out 14 --seed SEED --out DIR --workers 2

An interrupted trial goes on in its folder. ``--tree OTHER`` asks the diagnosis of another checkout
about the same cells. Never publish a seed that was used in development.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from statistics import median

BENCH = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(BENCH))

from blind import draw, score  # noqa: E402

LIMIT = 1800
"""s; a diagnosis that takes longer has failed: half a minute is usual."""
DONE = (0, 4, 5)
"""Exit codes of a command that has done its work."""


def parse(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser('otf blind', description=__doc__.split('\n')[0])
    count = {'type': int, 'default': 0, 'metavar': 'N'}
    parser.add_argument('--trials', help='cells of machines with three axes', **count)
    parser.add_argument('--rotary', help='cells of machines with rotary axes', **count)
    parser.add_argument(
        '--leave-out', help='cells whose effect the diagnosis does without', **count
    )
    parser.add_argument('--seed', type=int, required=True, help='of all random draws')
    parser.add_argument('--out', type=Path, required=True, metavar='DIR', help='of the trial')
    parser.add_argument('--workers', type=int, default=1, metavar='N', help='processes at once')
    parser.add_argument(
        '--tree',
        type=Path,
        default=BENCH.parent,
        metavar='CHECKOUT',
        help='whose diagnosis to ask',
    )
    alone = parser.add_mutually_exclusive_group()
    alone.add_argument('--only-draw', action='store_true', help='diagnose nothing')
    alone.add_argument(
        '--only-score', action='store_true', help='score the answers that are there'
    )
    given = parser.parse_args(words)
    if min(given.trials, given.rotary, given.leave_out) < 0 or given.workers < 1 or given.seed < 0:
        parser.error('numbers of cells and seed: 0 or more; workers: 1 or more')
    if not (given.tree / 'src/otf_core/otf_core').is_dir():
        parser.error(f'--tree {given.tree}: holds no src/otf_core/otf_core')
    return given


def draw_all(given: argparse.Namespace) -> None:
    """Draw what is not there yet, and seal the key."""
    asked = {n: getattr(given, n) for n in ('trials', 'rotary', 'leave_out', 'seed')}
    if (given.out / draw.SEAL).exists():
        key = draw.open_key(given.out)
        if {n: key[n] for n in asked} != asked:
            raise SystemExit(f'{given.out}: holds another trial; choose another folder')
        return
    orders = draw.orders(given.trials, given.rotary, given.leave_out, given.seed)
    if not orders:
        raise SystemExit('nothing to draw: give --trials, --rotary or --leave-out')
    given.out.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(given.workers) as pool:
        jobs = [pool.submit(draw.write_cell, given.out, given.seed, *o) for o in orders]
        cells = []
        for job, order in zip(jobs, orders, strict=True):
            cells.append(job.result())
            print(f'{order[0]} drawn', file=sys.stderr)
    print(f'SHA-256 of the key: {draw.seal(given.out, {**asked, "cells": cells})}')


def answers_of(given: argparse.Namespace) -> Path:
    """Where the answers of a checkout lie."""
    own = given.tree.resolve() == BENCH.parent
    return given.out / ('answers' if own else f'answers-{given.tree.resolve().name}')


def ask(given: argparse.Namespace, entry: draw.Entry) -> None:
    """Diagnose one cell in a process of its own; cost.json says what it took."""
    cell, out = f'cells/{entry["cell"]}', answers_of(given).absolute() / entry['cell']
    if (out / 'cost.json').exists():
        return
    bags = sorted(p.name for p in (given.out / cell).glob('bag*'))
    words = [sys.executable, '-m', 'otf_core.cli', 'diagnose', *(f'{cell}/{b}' for b in bags),
             '--machine', f'{cell}/machine.yaml', '--out', str(out), '--overwrite']  # fmt: skip
    if entry['without']:
        config = out.parent / f'{entry["cell"]}.yaml'
        config.write_text(f'exclude: {json.dumps(entry["without"])}\n')
        words += ['--config', str(config)]
    error = out.parent / f'{entry["cell"]}.err'
    env = {**os.environ, 'PYTHONPATH': str(given.tree.resolve() / 'src/otf_core')}
    with error.open('w') as stream:
        run = subprocess.Popen(['timeout', str(LIMIT), *words], cwd=given.out, env=env,
                               stdout=subprocess.DEVNULL, stderr=stream)  # fmt: skip
        _, status, used = os.wait4(run.pid, 0)
        run.returncode = code = os.waitstatus_to_exitcode(status)
    cost = {'exit': code, 'seconds': used.ru_utime + used.ru_stime, 'MB': used.ru_maxrss // 1024,
            'said': error.read_text().strip()[-300:]}  # fmt: skip
    out.mkdir(exist_ok=True)
    (out / 'cost.json').write_text(json.dumps(cost))
    print(f'{entry["cell"]}: exit {code}, {cost["seconds"]:.0f} s', file=sys.stderr)


def ask_all(given: argparse.Namespace) -> None:
    """Diagnose all cells that have no answer yet."""
    answers_of(given).mkdir(exist_ok=True)
    with ThreadPoolExecutor(given.workers) as pool:
        list(pool.map(partial(ask, given), draw.open_key(given.out)['cells']))


def score_all(given: argparse.Namespace) -> str:
    """Open the key and score the answers that are there."""
    key, folder = draw.open_key(given.out), answers_of(given)
    asked, costs = [], []
    for entry in key['cells']:
        own = folder / entry['cell']
        if not (own / 'cost.json').exists():
            continue
        cost = json.loads((own / 'cost.json').read_text())
        costs.append(cost)
        done = cost['exit'] in DONE and (own / 'gap.json').exists()
        answer = json.loads((own / 'gap.json').read_text()) if done else {
            'failed': f'exit {cost["exit"]}: {cost["said"]}'}  # fmt: skip
        asked.append((entry, answer))
    if not asked:
        raise SystemExit(f'{folder}: holds no answers')
    with ProcessPoolExecutor(given.workers) as pool:
        jobs = [pool.submit(score.achieved_percent, key['seed'], e, a['causes'])
                if score.can_be_achieved(e, a) else None for e, a in asked]  # fmt: skip
        achieved = [job.result() if job else None for job in jobs]
    outcomes = [score.judge(e, a, s) for (e, a), s in zip(asked, achieved, strict=True)]
    table = score.rows(outcomes)
    seconds = [c['seconds'] for c in costs]
    text = '\n\n'.join([
        f'{len(outcomes)} cells of seed {key["seed"]}, {folder.name}; a diagnosis took '
        f'{median(seconds):.0f} s of a processor, at most {max(seconds):.0f} s and '
        f'{max(c["MB"] for c in costs)} MB; key {(given.out / draw.SEAL).read_text()[:16]}...',
        score.as_markdown(table), score.misses(outcomes),
    ])  # fmt: skip
    (folder / 'score.txt').write_text(text + '\n')
    found = {'rows': table, 'cells': [asdict(o) for o in outcomes]}
    (folder / 'score.json').write_text(json.dumps(found, indent=1))
    return text


def main(words: Sequence[str] | None = None) -> None:
    """Run a trial, or part of one."""
    given = parse(words)
    if not given.only_score:
        draw_all(given)
    if given.only_draw:
        return
    if not given.only_score:
        ask_all(given)
    print(score_all(given))


if __name__ == '__main__':
    main()

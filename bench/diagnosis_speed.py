# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of five minutes: time and memory of the whole command, for one run and for two.

Simulated runs of two laps, 500 samples per second, with backlash and a drift of the structure;
the second from another tracker place. ``./otf diagnose`` runs as a child process, start of Python
and all files included, and its largest resident memory is that which the system counts. For
comparison rosbags' AnyReader, which only turns the same bags into message objects and arrays.
Wall time, and processor time, which depends less on what else the machine does.

Usage: PYTHONPATH=src/otf_core python bench/diagnosis_speed.py [REPEATS]
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from with_rosbags import read_with_rosbags

from otf_core.bags.bag import BagContent, write_bag
from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.files.writing import write_text
from otf_core.model.machine import load_machine
from otf_core.planning.path_creation import plan_path
from otf_core.sim.cell import simulate

MACHINE = Path(__file__).parent.parent / 'src/otf_bringup/config/machine.yaml'
SEEDS = (20_260_012, 20_260_013)
EFFECTS = (
    AppliedEffect(REGISTRY['backlash'], {'B_X': 5e-6}),
    AppliedEffect(REGISTRY['thermal_structure_drift'], {'tau': 150.0, 'D_X': 6e-6, 'D_Z': -5e-6}),
)


@dataclass(frozen=True)
class Used:
    """What a process took: wall and processor time in s, largest resident memory in bytes."""

    wall: float
    processor: float
    memory: float


def recorded(folder: Path) -> tuple[list[Path], int]:
    """Bags of two runs of one machine, and the samples of each."""
    machine, truth, bags = load_machine(MACHINE), None, []
    plan = plan_path(machine, PlannerConfig(feed=0.5))
    for seed in SEEDS:
        run = simulate(machine, plan, SimulationConfig(seed=seed), truth, EFFECTS)
        truth = run.truth
        bags.append(folder / f'bag {seed}')
        write_bag(bags[-1], BagContent(run.samples, plan.path))
    return bags, len(run.samples)


def diagnosed(bags: Sequence[Path], folder: Path) -> Used:
    """Run the command itself."""
    words = [*map(str, bags), '--machine', str(folder / 'machine.yaml'), '--overwrite']
    words = ['-m', 'otf_core.cli', 'diagnose', *words, '--out', str(folder / 'out')]
    start = time.perf_counter()
    child = os.posix_spawn(
        sys.executable,
        [sys.executable, *words],
        os.environ,
        file_actions=[(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)],
    )
    _, status, usage = os.wait4(child, 0)
    wall = time.perf_counter() - start
    assert os.waitstatus_to_exitcode(status) == 0
    # the system counts what the parent had at the start of the child as well
    assert usage.ru_maxrss > resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Used(wall, usage.ru_utime + usage.ru_stime, 1024.0 * usage.ru_maxrss)


def read_only(bags: Sequence[Path]) -> tuple[float, float]:
    """Wall and processor time in which rosbags reads the bags, s."""
    start, used = time.perf_counter(), time.process_time()
    for bag in bags:
        read_with_rosbags(bag)
    return time.perf_counter() - start, time.process_time() - used


def main(repeats: int = 3) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_text(folder / 'machine.yaml', MACHINE.read_text(encoding='utf-8'))
        bags, samples = recorded(folder)
        print(f'{samples} samples a run, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}')
        print(f'{"":12}{"wall s":>9}{"ratio":>8}{"processor s":>13}{"ratio":>8}{"memory MB":>11}')
        for name, part in (('one run', bags[:1]), ('two runs', bags)):
            wall, processor = read_only(part)
            found = [diagnosed(part, folder) for _ in range(repeats)]
            best = Used(*(min(getattr(u, n) for u in found) for n in ('wall', 'processor')),
                        max(u.memory for u in found))  # fmt: skip
            print(f'{name:12}{best.wall:9.2f}{best.wall / wall:8.2f}{best.processor:13.2f}'
                  f'{best.processor / processor:8.2f}{1e-6 * best.memory:11.0f}')  # fmt: skip


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))

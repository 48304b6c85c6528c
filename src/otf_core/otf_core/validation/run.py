# SPDX-License-Identifier: Apache-2.0
"""All comparisons of the paper on simulated cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from otf_core.comparison.compare import Comparison
from otf_core.comparison.compare import agreement as share_within
from otf_core.config import STANDSTILL
from otf_core.live.time_left import StepsLeft
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.machine import Machine
from otf_core.validation.direct import direct_test, largest_differences
from otf_core.validation.laboratory import Laboratory, Scale, paper_machine
from otf_core.validation.reference_points import (
    ReferenceTest,
    agreement,
    reference_test,
)
from otf_core.validation.simulative import Replication, SimulativeRun, simulative_run
from otf_core.validation.table import Row

MAX_SHARE = 0.5
"""%, of the error left after compensation: about half of what the paper leaves."""
MAX_FEED_INFLUENCE = 0.25
"""um: half of the difference between the methods that the paper calls slight."""
MIN_AGREEMENT = 90.0
"""%, of differences within their expanded uncertainties (k = 2); 95 are to be expected."""


@dataclass(frozen=True)
class Cell:
    """Outcome for one simulated cell."""

    simulative: Replication
    noiseless: Replication
    reference: ReferenceTest
    direct: Comparison


@dataclass(frozen=True)
class Validation:
    """Outcome of all cells, by seed; ``example`` and the first cell serve the figures."""

    seeds: tuple[int, ...]
    rows: tuple[Row, ...]
    cells: tuple[Cell, ...]
    example: SimulativeRun


def validate(
    laboratory: Laboratory,
    scale: Scale,
    progress: Callable[[str], None] = lambda text: None,
    machine: Machine | None = None,
) -> Validation:
    """Run every comparison on every cell.

    Parameters
    ----------
    laboratory : Laboratory
    scale : Scale
    progress : callable(text), optional
        Told what comes next.
    machine : Machine, optional
        A cell like the paper's if not given.
    """
    machine = machine or paper_machine()
    cells: list[Cell] = []
    example: SimulativeRun | None = None
    left, ahead = StepsLeft(len(scale.seeds)), ''
    for number, seed in enumerate(scale.seeds, start=1):
        where = f'cell {number} of {len(scale.seeds)}{ahead}'
        progress(f'{where}: errors of 100 um on path and grid')
        run = simulative_run(laboratory, machine, seed)
        noiseless = simulative_run(laboratory, machine, seed, noise=False)
        progress(f'{where}: standstill and {len(scale.feeds)} feeds predict reference points')
        reference = reference_test(laboratory, machine, seed, scale)
        slowest = reference.results[list(reference.results)[1]]
        direct = direct_test(laboratory, reference.truth, slowest, seed)
        cells.append(Cell(run.replication, noiseless.replication, reference, direct))
        example, ahead = example or run, left.after_one()
    assert example is not None
    rows = (*_simulative_rows(cells), *_reference_rows(cells), *_direct_rows(cells))
    return Validation(scale.seeds, rows, tuple(cells), example)


def _simulative_rows(cells: list[Cell]) -> list[Row]:
    runs = [c.simulative for c in cells]

    def um(name: str, source: list[Replication]) -> tuple[float, ...]:
        return tuple(1e6 * getattr(r, name) for r in source)

    def share(place: str, source: list[Replication]) -> tuple[float, ...]:
        return tuple(
            100 * getattr(r, f'{place}_after') / getattr(r, f'{place}_before') for r in source
        )

    quiet = [c.noiseless for c in cells]
    limit = (0.0, MAX_SHARE)
    return [
        Row('2.1', 'error across the path', '117 um', 'um', um('path_before', runs)),
        Row('2.1', 'left of it after compensation', '0.95 um', 'um', um('path_after', runs)),
        Row('2.1', 'share left on the path', '0.81 %', '%', share('path', runs), limit),
        Row('2.1', 'error on the grid', '103 um', 'um', um('grid_before', runs)),
        Row('2.1', 'left of it after compensation', '0.87 um', 'um', um('grid_after', runs)),
        Row('2.1', 'share left on the grid', '0.84 %', '%', share('grid', runs), limit),
        Row('2.1', 'share left on the grid, no noise', '', '%', share('grid', quiet), limit),
    ]


def _true_errors(test: ReferenceTest, method: str) -> float:
    q = lattice(test.truth.machine)
    left = displacement(test.truth, q) - displacement(test.results[method].tables, q)
    return 1e6 * mean_length(without_rigid_motion(left, q))


def _reference_rows(cells: list[Cell]) -> list[Row]:
    tests = [c.reference for c in cells]
    feeds = [m for m in tests[0].results if m != STANDSTILL]
    paper_minutes = {'2500': '24', '5000': '10', '10000': '5.5', '15000': '4', STANDSTILL: '18'}
    rows = [
        Row('2.2', f'driving time, {_title(m)}', f'{paper_minutes.get(m, "?")} min', 'min',
            tuple(t.durations[m] / 60 for t in tests))
        for m in (STANDSTILL, *feeds)
    ]  # fmt: skip
    rows.append(
        Row('2.2', 'reference points, uncompensated', 'Figure 5', 'um',
            tuple(1e6 * t.uncompensated for t in tests))
    )  # fmt: skip
    for m in (STANDSTILL, *feeds):
        values = tuple(1e6 * t.residual[m] for t in tests)
        rows.append(Row('2.2', f'reference points, {_title(m)}', 'Figure 5', 'um', values))
    for m in (STANDSTILL, *feeds):
        values = tuple(_true_errors(t, m) for t in tests)
        rows.append(Row('2.2', f'against the truth on a grid, {_title(m)}', '', 'um', values))
    slow = tuple(
        1e6 * (float(np.mean([t.residual[f] for f in feeds])) - t.residual[STANDSTILL])
        for t in tests
    )
    fast = tuple(1e6 * (t.residual[feeds[-1]] - t.residual[feeds[0]]) for t in tests)
    within = tuple(
        100 * float(np.mean([share_within(agreement(t.results[STANDSTILL], t.results[f]))
                             for f in feeds]))
        for t in tests
    )  # fmt: skip
    feeds_agree = tuple(
        100 * share_within(agreement(t.results[feeds[0]], t.results[feeds[-1]])) for t in tests
    )
    return [
        *rows,
        Row('2.2', 'on the fly less standstill', '0.5 um', 'um', slow, (-np.inf, 0.5)),
        Row('2.2', 'fastest less slowest feed', 'not significant', 'um', fast,
            (-np.inf, MAX_FEED_INFLUENCE)),
        Row('2.2', 'fastest and slowest feed within U, k = 2', '', '%', feeds_agree,
            (MIN_AGREEMENT, 100.0)),
        Row('2.2', 'standstill and on the fly within U, k = 2', '', '%', within,
            (MIN_AGREEMENT, 100.0)),
    ]  # fmt: skip


def _title(method: str) -> str:
    return method if method == STANDSTILL else f'{method} mm/min'


def _direct_rows(cells: list[Cell]) -> list[Row]:
    fits = [c.reference.results[list(c.reference.results)[1]].fit for c in cells]
    largest = [largest_differences(c.direct) for c in cells]
    volumes = [c.direct.volume for c in cells]

    def of(values: list[float], factor: float = 1e6) -> tuple[float, ...]:
        return tuple(factor * v for v in values)

    return [
        Row('2.3', 'samples at the slowest feed', '> 500000', '',
            of([f.samples for f in fits], 1)),
        Row('2.3', 'values left by data reduction', '4427', '',
            of([f.pieces for f in fits], 1)),
        Row('2.3.1', 'positioning, largest difference', '< 10 um', 'um',
            of([d[0] for d in largest]), (0.0, 5.0)),
        Row('2.3.1', 'straightness, largest difference', '< 5 um', 'um',
            of([d[1] for d in largest]), (0.0, 2.5)),
        Row('2.3.1', 'rotations, largest difference', 'up to 25 urad', 'urad',
            of([d[2] for d in largest]), (0.0, 12.5)),
        Row('2.3.2', 'grid error, direct instrument', '7.2 um', 'um',
            of([mean_length(v.a) for v in volumes])),
        Row('2.3.2', 'grid error, on the fly', '6.9 um', 'um',
            of([mean_length(v.b) for v in volumes])),
        Row('2.3.2', 'grid, difference', '2.65 um', 'um',
            of([mean_length(v.difference) for v in volumes]), (0.0, 1.3)),
        Row('2.3.2', 'grid, components with E_n <= 1', '', '%',
            of([share_within(v.normalised) for v in volumes], 100), (MIN_AGREEMENT, 100.0)),
    ]  # fmt: skip

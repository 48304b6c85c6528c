# SPDX-License-Identifier: Apache-2.0
"""The comparisons with a process for every cell: ``otf validate --cells 1``, and one table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from otf_core.files.json_file import read_json
from otf_core.fleet.job import VERBS, Job, JobResult, hash_of
from otf_core.sim.cell import EPOCH_NS
from otf_core.validation.table import Row, rows_from_dict, side_by_side

RESULT = 'validation.json'


def cell_jobs(seed: int, cells: int, folder: Path) -> list[Job]:
    """Return a job for every cell.

    Parameters
    ----------
    seed : int
        Of the first cell; the others count on.
    cells : int
    folder : Path
        ``FOLDER/SEED/`` holds table and figures of a cell.
    """
    jobs = []
    for one in range(seed, seed + cells):
        name = str(one)
        out = str((folder / name).absolute())
        cell = (VERBS, 'validate', '--cells', '1', '--seed', name)
        words = (*cell, '--out', out, '--overwrite', '--quiet')
        jobs.append(Job(name, words, out, RESULT, hash_of(cell), EPOCH_NS // 10**9))
    return jobs


def table_of(folder: Path, outcomes: Mapping[str, JobResult]) -> tuple[list[int], tuple[Row, ...]]:
    """Return seeds and table of the cells that are done."""
    names = [name for name, ended in outcomes.items() if ended.done]
    tables = [rows_from_dict(read_json(folder / name / RESULT)['rows']) for name in names]
    return [int(name) for name in names], side_by_side(tables)

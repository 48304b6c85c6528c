# SPDX-License-Identifier: Apache-2.0
"""Cells of a bench spread over processes or hosts, by the machinery of `otf fleet`."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from otf_core.files.strict_yaml import read_json
from otf_core.fleet.fleet import call_job, done_by_dask, done_here, run_fleet

PLACES = [str(p) for p in (Path(__file__).resolve().parent,
                           Path(__file__).resolve().parents[1] / 'src/otf_core/test')]  # fmt: skip


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what says who does the cells, and where they are kept."""
    parser.add_argument('--workers', type=int, default=1, help='cells at once')
    parser.add_argument('--scheduler', help='address of a Dask scheduler, in place of --workers')
    parser.add_argument('--out', type=Path, help='keep the cells there; a restart goes on')


def spread(
    function: str, cells: Mapping[str, Mapping[str, Any]], given: argparse.Namespace
) -> dict[str, Any]:
    """Call a function on the arguments of every cell; results by cell, those that failed not.

    Parameters
    ----------
    function : str
        'module:function' of the bench; takes and returns plain data.
    cells : mapping of name to arguments
    given : Namespace
        See ``add_options``.
    """
    if given.scheduler:
        workers = partial(done_by_dask, address=given.scheduler)
    else:
        workers = partial(done_here, workers=given.workers)
    with tempfile.TemporaryDirectory() as name:
        folder = (given.out or Path(name)).absolute()
        jobs = [
            call_job(cell, function, arguments, folder / cell, places=PLACES)
            for cell, arguments in cells.items()
        ]
        ended = run_fleet(jobs, folder, workers, lambda text: None)
        for cell, outcome in ended.items():
            if not outcome.done:
                print(f'{cell}: {outcome.message}', file=sys.stderr)
        return {
            job.name: read_json(Path(job.out) / job.result) for job in jobs if ended[job.name].done
        }

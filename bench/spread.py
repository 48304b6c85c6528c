# SPDX-License-Identifier: Apache-2.0
"""Cells of a bench spread over processes."""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from typing import Any


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what says how many cells are done at once."""
    parser.add_argument('--workers', type=int, default=1, help='cells at once')


def spread(
    function: Callable[..., Any], cells: Mapping[str, Mapping[str, Any]], workers: int
) -> dict[str, Any]:
    """Call a function on the arguments of every cell; results by cell, those that failed not."""
    found = {}
    with ProcessPoolExecutor(workers, multiprocessing.get_context('spawn')) as pool:
        jobs = {cell: pool.submit(function, **arguments) for cell, arguments in cells.items()}
        for cell, job in jobs.items():
            if error := job.exception():
                print(f'{cell}: {type(error).__name__}: {error}', file=sys.stderr)
            else:
                found[cell] = job.result()
    return found

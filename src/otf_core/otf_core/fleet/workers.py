# SPDX-License-Identifier: Apache-2.0
"""Who does the jobs: processes of this computer, or the workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

from otf_core.errors import ConfigError
from otf_core.fleet.job import Job, JobResult, run_job

CONNECT = 20.0
"""s to wait for a scheduler and its workers."""


def done_here(jobs: Sequence[Job], workers: int) -> Iterator[tuple[Job, JobResult]]:
    """Do jobs on this computer; yield each as it ends.

    Parameters
    ----------
    jobs : sequence of Job
    workers : int
        Jobs at once: a thread each that waits for the process of its job.
    """
    with ThreadPoolExecutor(workers) as pool:
        waiting: dict[Future[JobResult], Job] = {pool.submit(run_job, job): job for job in jobs}
        try:
            while waiting:
                ended, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in ended:
                    yield waiting.pop(future), future.result()
        finally:
            for future in waiting:
                future.cancel()


def done_by_dask(jobs: Sequence[Job], address: str) -> Iterator[tuple[Job, JobResult]]:
    """Do jobs on the workers of a Dask scheduler; yield each as it ends.

    All hosts see the same files under the same names, and have otf_core of the same version. A
    worker that dies loses its jobs to others.

    Raises
    ------
    ConfigError
        If Dask distributed is missing, or nothing answers at the address.
    """
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise ConfigError(
            '--scheduler: needs Dask distributed on this computer and on the workers: '
            'python3 -m pip install distributed'
        ) from None
    try:
        client = Client(address, timeout=CONNECT)
        client.wait_for_workers(1, timeout=CONNECT)
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(f'--scheduler: {address}: no workers there ({error})') from None
    with client:
        futures = {client.submit(run_job, job, pure=False): job for job in jobs}
        for future in as_completed(futures):
            lost = future.exception()
            if lost is not None:
                yield futures[future], JobResult(1, f'lost by its workers: {lost}', None)
            else:
                yield futures[future], future.result()

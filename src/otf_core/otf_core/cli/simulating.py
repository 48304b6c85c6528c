# SPDX-License-Identifier: Apache-2.0
"""Verbs that plan and simulate: plan, simulate, fleet."""

from __future__ import annotations

import argparse
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from otf_core.cli.options import (
    AddVerb,
    add_config,
    given,
    output_folder,
    parameters,
)
from otf_core.cli.output import (
    answer,
    finish,
    note,
    progress_of,
    report_files,
)
from otf_core.config import ForecastConfig, PlannerConfig, SimulationConfig
from otf_core.errors import ConfigError, InputError
from otf_core.live.stages import PLAN, SIMULATE

if TYPE_CHECKING:
    from otf_core.fleet.fleet import Workers


def run_simulate(arguments: argparse.Namespace) -> int:
    """Bag of a simulated run."""
    from otf_core.api import functions as api
    from otf_core.model.machine import load_machine
    from otf_core.sim.bag_files import SimulatedBag

    config = parameters(SimulationConfig, arguments)
    planning = parameters(PlannerConfig, arguments)
    read = {w: getattr(arguments, w) for w in ('tables', 'path', 'effects')}
    inputs = [name for name in (arguments.machine, *read.values()) if name]
    out = SimulatedBag(arguments.out, overwrite=arguments.overwrite, inputs=inputs)
    machine = load_machine(arguments.machine)
    plan, place = None, None
    if arguments.path is not None:
        stated = given(arguments, PlannerConfig)
        plan, place = api.read_plan(arguments.path, machine, planning, stated)
    with progress_of('simulating', SIMULATE) as progress:
        try:
            made = api.simulate(
                machine, plan, tables=arguments.tables, effects=arguments.effects, config=config,
                tracker_place=place, planning=planning,
            )  # fmt: skip
        except InputError as error:
            raise ConfigError(f'{arguments.path or arguments.machine}: {error}') from None
        progress('writing', 0.0)
        out.write(made.run, config, made.effects, read)
    samples, place = made.run.samples, made.run.pose.translation
    data = {
        'samples': len(samples),
        'duration_s': float(samples.time[-1]),
        'tracker_place': place.tolist(),
        'seed': config.seed,
        'out': arguments.out,
    }
    words = (
        f'{len(samples)} samples over {samples.time[-1]:.1f} s in {arguments.out}, '
        f'tracker at ({", ".join(f"{1e3 * v:.0f}" for v in place)}) mm'
    )
    if made.run.path is None:
        words += f'; parts: {", ".join(part.target for part in made.run.parts)}'
    answer(arguments, words, data)
    return 0


def run_plan(arguments: argparse.Namespace) -> int:
    """Path for a machine, forecast of what it can see, NC program."""
    from otf_core.api import functions as api
    from otf_core.model.machine import load_machine
    from otf_core.planning.nc import DIALECTS
    from otf_core.planning.plan_report import read_place
    from otf_core.reports.plan_files import write_plan

    config = parameters(PlannerConfig, arguments)
    judged = parameters(ForecastConfig, arguments)
    read = (arguments.machine, arguments.path, arguments.noise, arguments.after)
    out = output_folder(arguments, *filter(None, read))
    machine, place = load_machine(arguments.machine), arguments.tracker_place
    wanted = arguments.wanted_uncertainty
    path = None
    if arguments.path is not None:
        path, _ = api.read_plan(arguments.path, machine, config, given(arguments, PlannerConfig))
    with progress_of('choosing lines', PLAN) as progress:
        report = api.plan(
            machine, path, time_budget=arguments.time_budget,
            wanted_uncertainty=None if wanted is None else 1e-6 * wanted,
            tracker_place=None if place is None else read_place(place), noise=arguments.noise,
            after=arguments.after, config=config, forecast=judged, progress=progress,
            files={'path': arguments.path, 'noise': arguments.noise},
        )  # fmt: skip
    if arguments.dialect is None:
        note(f'no NC program: give --dialect {"|".join(DIALECTS)} for one')
    dialect = arguments.dialect and DIALECTS[arguments.dialect]
    return finish(arguments, out, report.document, partial(write_plan, report, dialect=dialect))


# The verb on many runs, a process each, here or on other hosts: fleet.


def add_plant_verbs(verb: AddVerb) -> None:
    """Add fleet."""
    sub = verb('fleet', run_fleet_verb)
    sub.add_argument('what', choices=('calibrate', 'diagnose'), help='command for each run')
    sub.add_argument(
        '--list', metavar='runs.csv', required=True,
        help='CSV with the header name,bag,machine; paths may be relative to its folder',
    )  # fmt: skip
    add_config(sub, 'fleet')
    sub.add_argument(
        '--out', required=True,
        help='folder for the results and fleet.json; an interrupted fleet resumes there',
    )  # fmt: skip
    sub.add_argument(
        '--workers', type=int, metavar='N', help='parallel runs (default: one per core)'
    )
    sub.add_argument(
        '--scheduler', metavar='ADDRESS',
        help='address of a Dask scheduler, e.g. tcp://host:8786, whose workers process the runs',
    )  # fmt: skip


def _workers(arguments: argparse.Namespace) -> Workers:
    """Who does the runs."""
    from otf_core.fleet.fleet import done_by_dask, done_here

    count = arguments.workers
    if count is not None and not 1 <= count <= 1000:
        raise ConfigError(f'--workers: {count} is out of range [1, 1000]')
    if count is not None and arguments.scheduler is not None:
        raise ConfigError('--workers: the scheduler has its own; leave it out with --scheduler')
    if arguments.scheduler is not None:
        return partial(done_by_dask, address=arguments.scheduler)
    return partial(done_here, workers=count or os.cpu_count() or 1)


def run_fleet_verb(arguments: argparse.Namespace) -> int:
    """Calibrate or diagnose many recordings."""
    from otf_core.files.output_folder import MANIFEST, write_manifest, written_files
    from otf_core.fleet.document import fleet_document
    from otf_core.fleet.fleet import listed_jobs, read_list, run_fleet, take_folder
    from otf_core.reports.pages import summary_of, write_document

    verb, workers = arguments.what, _workers(arguments)
    runs = read_list(arguments.list)
    folder = take_folder(Path(arguments.out), verb)
    jobs = listed_jobs(verb, runs, folder, arguments.config)
    outcomes = run_fleet(jobs, folder, workers, lambda text: note(f'otf fleet: {text}'))
    document = fleet_document(verb, folder, outcomes)
    files = write_document(document, folder)
    write_manifest(folder / MANIFEST, written_files(folder), f'fleet {verb}')
    words = summary_of(document) + report_files(files, arguments.out)
    answer(arguments, words, document.to_dict())
    return document.exit_code

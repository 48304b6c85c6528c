# SPDX-License-Identifier: Apache-2.0
"""Verbs that plan and simulate: plan, simulate, fleet."""

from __future__ import annotations

import argparse
import dataclasses
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from otf_core.cli.options import (
    AddVerb,
    add_config,
    given,
    output_folder,
    parameters,
)
from otf_core.cli.output import (
    LIMIT_NOT_PROVEN,
    QUALITY_GATE_FAILED,
    answer,
    answer_from,
    note,
    progress_of,
    report_files,
)
from otf_core.config import ForecastConfig, PlannerConfig, SimulationConfig
from otf_core.errors import ConfigError, InputError, OtfError
from otf_core.live.stages import PLAN, SIMULATE

if TYPE_CHECKING:
    from otf_core.fleet.fleet import Workers


# Verbs that plan and simulate: plan, simulate.

DWELLS = ('corner_dwell', 'end_dwell')
"""Parameters of the planner that a plan leaves to --config."""


def _plan_of(arguments: argparse.Namespace, config: PlannerConfig, machine: Any) -> Any:
    """Plan of --path, and the place of the tracker that it assumes or None."""
    from otf_core.inputs.path_file import (
        holds_axis_positions,
        looks_like_json,
        read_axis_paths,
        read_path,
        read_plan,
    )
    from otf_core.model.axis_path import AxisPath
    from otf_core.model.plan import check_inside, plan_along

    name, place = arguments.path, None
    try:
        if looks_like_json(name):
            file = read_plan(name)
            if file.link != machine.tracker.link:
                raise ConfigError(
                    f'{name}: plans a tracker on link {file.link}, machine.yaml states '
                    f'{machine.tracker.link}: plan again with this machine.yaml'
                )
            plan, place = (
                _with_dwells(file.plan.of(machine), arguments, config),
                file.tracker_place,
            )
        elif machine.rotary_names or holds_axis_positions(name):
            plan = plan_along(machine, read_axis_paths(name, machine.axis_names), config)
        else:
            corners, words = read_path(name)
            if words:
                note(f'otf {arguments.verb}: {words}')
            plan = plan_along(machine, [AxisPath.of_points(machine, corners)], config)
        check_inside(plan, machine)
    except ConfigError as error:
        if 'header x,y,z' not in str(error):
            raise
        raise ConfigError(f'{error}; or give the plan.json of otf plan') from None
    except OtfError as error:
        raise ConfigError(f'{name}: {error}') from None
    return plan, place


def _with_dwells(plan: Any, arguments: argparse.Namespace, config: PlannerConfig) -> Any:
    """Take the dwells from the options where given; refuse options that the plan decides."""
    stated = given(arguments, PlannerConfig)
    for name in stated:
        if name not in DWELLS:
            raise ConfigError(
                f'{name}: {arguments.path} is a plan, which sets this; give its path.csv to drive '
                f'the same path with other settings'
            )
    parts = []
    for part in plan.parts:
        dwell = part.dwell.copy()
        if 'corner_dwell' in stated and not part.stops:
            dwell[1:-1][dwell[1:-1] > 0.0] = config.corner_dwell
        if 'end_dwell' in stated:
            dwell[[0, -1]] = config.end_dwell
        parts.append(dataclasses.replace(part, dwell=dwell))
    return dataclasses.replace(plan, parts=tuple(parts))


def run_simulate(arguments: argparse.Namespace) -> int:
    """Bag of a simulated run."""
    config = parameters(SimulationConfig, arguments)
    planning = parameters(PlannerConfig, arguments)
    from otf_core.effects.effects_yaml import read_effects
    from otf_core.model.machine import load_machine
    from otf_core.planning.forecast import Setup
    from otf_core.planning.part_choice import planned
    from otf_core.prediction.calibration_document import load_tables
    from otf_core.sim.bag_files import SimulatedBag
    from otf_core.sim.cell import simulate

    read = {w: getattr(arguments, w) for w in ('machine', 'tables', 'path', 'effects')}
    inputs = [name for name in read.values() if name]
    out = SimulatedBag(arguments.out, overwrite=arguments.overwrite, inputs=inputs)
    machine = load_machine(arguments.machine)
    effects = read_effects(arguments.effects, machine) if arguments.effects else ()
    tables = load_tables(arguments.tables).tables.on(machine) if arguments.tables else None
    if arguments.path is not None:
        plan, place = _plan_of(arguments, planning, machine)
    else:
        plan, place = planned(Setup.of(machine), planning), None
    with progress_of('simulating', SIMULATE) as progress:
        try:
            run = simulate(machine, plan, config, tables, effects, place)
        except InputError as error:
            raise ConfigError(f'{arguments.path or arguments.machine}: {error}') from None
        progress('writing', 0.0)
        del read['machine']  # the description has a place of its own in the block provenance
        out.write(run, config, effects, read)
    data = {
        'samples': len(run.samples),
        'duration_s': float(run.samples.time[-1]),
        'tracker_place': run.pose.translation.tolist(),
        'seed': config.seed,
        'out': arguments.out,
    }
    words = (
        f'{data["samples"]} samples over {data["duration_s"]:.1f} s in {arguments.out}, '
        f'tracker at ({", ".join(f"{1e3 * v:.0f}" for v in run.pose.translation)}) mm'
    )
    if run.path is None:
        words += f'; parts: {", ".join(part.target for part in run.parts)}'
    answer(arguments, words, data)
    return 0


def run_plan(arguments: argparse.Namespace) -> int:
    """Path for a machine, forecast of what it can see, NC program."""
    config = parameters(PlannerConfig, arguments)
    judged = parameters(ForecastConfig, arguments)
    from otf_core.files.strict_yaml import read_json
    from otf_core.model.machine import load_machine
    from otf_core.model.provenance import provenance
    from otf_core.noise.noise_model import read_noise
    from otf_core.planning.follow_up import measured_runs, open_questions
    from otf_core.planning.nc import DIALECTS
    from otf_core.planning.plan_report import PlanRequest, make_plan, read_place
    from otf_core.reports.plan_files import plan_summary, write_report

    given = (arguments.machine, arguments.path, arguments.noise, arguments.after)
    out = output_folder(arguments, *(name for name in given if name))
    machine = load_machine(arguments.machine)
    place, wanted = arguments.tracker_place, arguments.wanted_uncertainty
    after = arguments.after
    request = PlanRequest(
        given=None if arguments.path is None else _plan_of(arguments, config, machine)[0],
        time_budget=arguments.time_budget,
        wanted_uncertainty=None if wanted is None else 1e-6 * wanted,
        tracker_place=None if place is None else read_place(place),
        noise=None if arguments.noise is None else read_noise(arguments.noise),
        questions=() if after is None else tuple(open_questions(after, machine)),
        before=() if after is None or place is not None else tuple(measured_runs(after)),
    )
    dialect = None if arguments.dialect is None else DIALECTS[arguments.dialect]
    about = provenance(
        'plan', machines=[machine], files={'path': arguments.path, 'noise': arguments.noise}
    )
    with progress_of('choosing lines', PLAN) as progress:
        report = make_plan(machine, request, config, judged, progress)
        progress('writing', 0.0)
        with out.filled('plan') as folder:
            files = write_report(report, folder, dialect, about)
    if dialect is None:
        note(f'no NC program: give --dialect {"|".join(DIALECTS)} for one')
    words = plan_summary(read_json(out.path / 'plan.json')).rstrip()
    answer_from(arguments, words, files, 'plan.json')
    return 0


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
    from otf_core.fleet.fleet import listed_jobs, read_list, run_fleet, take_folder
    from otf_core.reports.fleet_report import format_fleet, write_fleet

    def told(text: str) -> None:
        note(f'otf {arguments.verb}: {text}')

    verb, workers = arguments.what, _workers(arguments)
    runs = read_list(arguments.list)
    folder = take_folder(Path(arguments.out), verb)
    jobs = listed_jobs(verb, runs, folder, arguments.config)
    outcomes = run_fleet(jobs, folder, workers, told)
    files, doc = write_fleet(verb, folder, outcomes)
    answer(arguments, format_fleet(doc) + report_files(files, arguments.out), doc)
    exits = {o.exit for o in outcomes.values()} - {0}
    if not exits:
        return 0
    return LIMIT_NOT_PROVEN if exits == {LIMIT_NOT_PROVEN} else QUALITY_GATE_FAILED

# SPDX-License-Identifier: Apache-2.0
"""Verbs that plan and simulate: plan, simulate, fleet."""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Sequence
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
    """Plan, and the place of the tracker that it assumes or None; as plan.json has them."""
    from otf_core.inputs.path_file import PlanFile, looks_like_json, read_path, read_plan
    from otf_core.model.path import NominalPath
    from otf_core.model.plan import check_inside, plan_for_path
    from otf_core.planning.path_creation import plan_path

    name = arguments.path
    if name is None:
        return PlanFile(plan_path(machine, config), None)
    try:
        if looks_like_json(name):
            file = _with_dwells(read_plan(name), arguments, config)
        else:
            corners, words = read_path(name)
            if words:
                note(f'otf {arguments.verb}: {words}')
            file = PlanFile(plan_for_path(NominalPath(corners), config), None)
        check_inside(file.plan.path, machine)
    except ConfigError as error:
        if 'header x,y,z' not in str(error):
            raise
        raise ConfigError(f'{error}; or give the plan.json of otf plan') from None
    except OtfError as error:
        raise ConfigError(f'{name}: {error}') from None
    return file


def _refuse_planned(arguments: argparse.Namespace) -> None:
    """Refuse options that a plan decides."""
    for name in given(arguments, PlannerConfig):
        if name not in DWELLS:
            raise ConfigError(
                f'{name}: {arguments.path} is a plan, which sets this; give its path.csv to drive '
                f'the same path with other settings'
            )


def _with_dwells(file: Any, arguments: argparse.Namespace, config: PlannerConfig) -> Any:
    """Take the dwells from the options where given; refuse options that the plan decides."""
    _refuse_planned(arguments)
    dwell = file.plan.dwell.copy()
    stated = given(arguments, PlannerConfig)
    if 'corner_dwell' in stated:
        dwell[1:-1] = config.corner_dwell
    if 'end_dwell' in stated:
        dwell[[0, -1]] = config.end_dwell
    return dataclasses.replace(file, plan=dataclasses.replace(file.plan, dwell=dwell))


def run_simulate(arguments: argparse.Namespace) -> int:
    """Bag of a simulated run."""
    config = parameters(SimulationConfig, arguments)
    planning = parameters(PlannerConfig, arguments)
    from otf_core.effects.effects_yaml import read_effects
    from otf_core.model.machine import load_machine
    from otf_core.model.tables import load_tables
    from otf_core.sim.bag_files import SimulatedBag
    from otf_core.sim.cell import simulate

    read = {w: getattr(arguments, w) for w in ('machine', 'tables', 'path', 'effects')}
    inputs = [name for name in read.values() if name]
    out = SimulatedBag(arguments.out, overwrite=arguments.overwrite, inputs=inputs)
    machine = load_machine(arguments.machine)
    if machine.rotary_names:
        return _simulate_axes(arguments, config, machine)
    effects = read_effects(arguments.effects, machine) if arguments.effects else ()
    tables = load_tables(arguments.tables).tables if arguments.tables else None
    if tables is not None:
        tables = tables.on(machine)
    file = _plan_of(arguments, planning, machine)
    with progress_of('simulating', SIMULATE) as progress:
        run = simulate(machine, file.plan, config, tables, effects, file.tracker_place)
        progress('writing', 0.0)
        del read['machine']  # the description has a place of its own in the block provenance
        out.write(run, file.plan, config, effects, read)
    place = ', '.join(f'{1e3 * v:.0f}' for v in run.place)
    words = (
        f'{len(run.samples)} samples over {run.samples.time[-1]:.1f} s in {arguments.out}, '
        f'tracker at ({place}) mm'
    )
    return _answer_run(arguments, config, run, words)


def _answer_run(
    arguments: argparse.Namespace, config: SimulationConfig, run: Any, words: str
) -> int:
    """State what was simulated."""
    data = {
        'samples': len(run.samples),
        'duration_s': float(run.samples.time[-1]),
        'tracker_place': run.place.tolist(),
        'seed': config.seed,
        'out': arguments.out,
    }
    answer(arguments, words, data)
    return 0


def _simulate_axes(arguments: argparse.Namespace, config: SimulationConfig, machine: Any) -> int:
    """Bag of a simulated run of a machine with rotary axes, and its truth."""
    from otf_core.effects.effects_yaml import read_effects
    from otf_core.files.output_folder import OutputFolder
    from otf_core.model.tables import load_tables
    from otf_core.sim.axis_cell import simulate_parts
    from otf_core.sim.axis_truth import write_axis_run

    if str(arguments.out).endswith('.mcap'):
        raise ConfigError(f'--out: {arguments.out}: give a folder for machines with rotary axes')
    given = [arguments.machine, arguments.tables, arguments.path, arguments.effects]
    effects = read_effects(arguments.effects, machine) if arguments.effects else ()
    out = OutputFolder(
        arguments.out,
        overwrite=arguments.overwrite,
        inputs=[name for name in given if name],
        occupied='exists already',
    )
    tables = load_tables(arguments.tables).tables.on(machine) if arguments.tables else None
    parts, options = _parts_to_drive(arguments, machine)
    with progress_of('simulating', SIMULATE) as progress:
        try:
            run = simulate_parts(machine, parts, config, tables, effects=effects, **options)
        except InputError as error:
            raise ConfigError(f'{arguments.path or arguments.machine}: {error}') from None
        progress('writing', 0.0)
        with out.filled('simulate') as folder:
            write_axis_run(run, config, folder, Path(arguments.out).name, effects)
    words = (
        f'{len(run.samples)} samples over {run.samples.time[-1]:.1f} s in {arguments.out}: '
        f'{len(run.parts)} parts ({", ".join(p.target for p in run.parts)})'
    )
    return _answer_run(arguments, config, run, words)


def _parts_to_drive(
    arguments: argparse.Namespace, machine: Any
) -> tuple[Sequence[Any], dict[str, Any]]:
    """Parts of the path, and how ``simulate_parts`` is to drive them: as planned, or as stated."""
    from otf_core.inputs.path_file import looks_like_json, read_axis_paths, read_axis_plan
    from otf_core.sim.axis_cell import usual_parts

    stated = given(arguments, PlannerConfig)
    dwell = stated.get('corner_dwell')
    options = {k: v for k, v in stated.items() if k == 'end_dwell'}
    name = arguments.path
    if name is None or not looks_like_json(name):
        options |= {k: v for k, v in stated.items() if k == 'feed'}
        options |= {} if dwell is None else {'dwell': dwell}
        parts = read_axis_paths(name, machine.axis_names) if name else usual_parts(machine)
        return parts, options
    _refuse_planned(arguments)
    file = read_axis_plan(name)
    if file.link != machine.tracker.link:
        raise ConfigError(
            f'{name}: plans a tracker on link {file.link}, machine.yaml states '
            f'{machine.tracker.link}: plan again with this machine.yaml'
        )
    plan = file.plan
    halts = [d if dwell is None or s else dwell
             for d, s in zip(plan.dwell, plan.stops, strict=True)]  # fmt: skip
    planned = {'end_dwell': file.end_dwell, 'feed': plan.feed, 'dwell': halts,
               'stops': plan.stops, 'tracker_place': file.tracker_place}  # fmt: skip
    return plan.parts, planned | options


def run_plan(arguments: argparse.Namespace) -> int:
    """Path for a machine, forecast of what it can see, NC program."""
    config = parameters(PlannerConfig, arguments)
    judged = parameters(ForecastConfig, arguments)
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
    if machine.rotary_names:
        return _plan_rotary(arguments, out, machine, config, judged)
    place, wanted = arguments.tracker_place, arguments.wanted_uncertainty
    after = arguments.after
    request = PlanRequest(
        given=None if arguments.path is None else _plan_of(arguments, config, machine).plan,
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
    answer_from(arguments, plan_summary(report).rstrip(), files, 'plan.json')
    return 0


def _plan_rotary(
    arguments: argparse.Namespace,
    out: Any,
    machine: Any,
    config: PlannerConfig,
    judged: ForecastConfig,
) -> int:
    """Parts for a machine with rotary axes, and forecast of what they can show."""
    import numpy as np

    from otf_core.model.provenance import provenance
    from otf_core.noise.noise_model import read_noise
    from otf_core.planning.clearance import near_misses
    from otf_core.planning.line_of_sight import check_side, default_tracker_place, sights
    from otf_core.planning.nc import DIALECTS
    from otf_core.planning.part_choice import planned_parts
    from otf_core.planning.plan_report import read_place
    from otf_core.planning.rotary_forecast import forecast_parts
    from otf_core.reports.rotary_plan import RotaryPlan, plan_words, write_plan

    for option in ('path', 'after', 'wanted_uncertainty'):
        if getattr(arguments, option) is not None:
            raise ConfigError(
                f'--{option.replace("_", "-")}: not available for machines with rotary axes'
            )
    given = arguments.tracker_place
    place = default_tracker_place(machine) if given is None else np.array(read_place(given))
    check_side(machine, place)
    noise = None if arguments.noise is None else read_noise(arguments.noise)
    about = provenance('plan', machines=[machine], files={'noise': arguments.noise})
    with progress_of('choosing lines', PLAN) as progress:
        parts = planned_parts(machine, config, place, judged, noise, arguments.time_budget)
        progress('forecasting', 0.0)
        forecast = forecast_parts(machine, parts, place, config, judged, noise)
        seen, near = sights(machine, place), near_misses(machine, parts, place)
        plan = RotaryPlan(machine, parts, config, place, forecast, seen, near)
        progress('writing', 0.0)
        with out.filled('plan') as folder:
            dialect = None if arguments.dialect is None else DIALECTS[arguments.dialect]
            files = write_plan(plan, folder, about, dialect)
    answer_from(arguments, plan_words(plan), files, 'plan.json')
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
    from otf_core.fleet.fleet import fleet_to_dict, listed_jobs, read_list, run_fleet, take_folder
    from otf_core.reports.fleet_report import format_fleet, write_fleet

    def told(text: str) -> None:
        note(f'otf {arguments.verb}: {text}')

    verb, workers = arguments.what, _workers(arguments)
    runs = read_list(arguments.list)
    folder = take_folder(Path(arguments.out), verb)
    jobs = listed_jobs(verb, runs, folder, arguments.config)
    outcomes = run_fleet(jobs, folder, workers, told)
    files, warnings = write_fleet(verb, folder, outcomes)
    words = '\n'.join([format_fleet(verb, outcomes), *warnings]) + report_files(
        files, arguments.out
    )
    answer(arguments, words, fleet_to_dict(verb, outcomes) | {'warnings': warnings})
    exits = {o.exit for o in outcomes.values()} - {0}
    if not exits:
        return 0
    return LIMIT_NOT_PROVEN if exits == {LIMIT_NOT_PROVEN} else QUALITY_GATE_FAILED

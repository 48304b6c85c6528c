# SPDX-License-Identifier: Apache-2.0
"""Verbs that plan, simulate and judge: plan, simulate, validate."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from otf_core.cli.options import output_folder, parameters
from otf_core.cli.output import QUALITY_GATE_FAILED, answer, answer_from, note
from otf_core.cli.progress import progress_of
from otf_core.config import ForecastConfig, PlannerConfig, SimulationConfig
from otf_core.errors import ConfigError, OtfError
from otf_core.live.stages import PLAN, SIMULATE

if TYPE_CHECKING:
    from otf_core.validation.table import Row

MOST_CELLS = 1000


def _plan_of(arguments: argparse.Namespace, config: PlannerConfig, machine: Any) -> Any:
    """Plan, and the place of the tracker that it assumes or None; as plan.json has them."""
    from otf_core.inputs.path_file import read_path
    from otf_core.inputs.plan_json import PlanFile, looks_like_json, read_plan
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


def _with_dwells(file: Any, arguments: argparse.Namespace, config: PlannerConfig) -> Any:
    """Take the dwells from the options where given; refuse options that the plan decides."""
    for option in ('passes', 'feed', 'feed_ratio', 'margin', 'levels'):
        if getattr(arguments, option) is not None:
            raise ConfigError(
                f'--{option.replace("_", "-")}: {arguments.path} is a plan and decides it; '
                f'give its path.csv to drive its path otherwise'
            )
    dwell = file.plan.dwell.copy()
    if arguments.corner_dwell is not None:
        dwell[1:-1] = config.corner_dwell
    if arguments.end_dwell is not None:
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
    effects = read_effects(arguments.effects, machine) if arguments.effects else ()
    tables = load_tables(arguments.tables).tables if arguments.tables else None
    if tables is not None:
        tables = tables.on(machine)
    file = _plan_of(arguments, planning, machine)
    with progress_of(arguments, 'simulating', SIMULATE) as progress:
        run = simulate(machine, file.plan, config, tables, effects, file.tracker_place)
        progress('writing', 0.0)
        del read['machine']  # the description has a place of its own in the block provenance
        out.write(run, file.plan, config, effects, read)
    place = ', '.join(f'{1e3 * v:.0f}' for v in run.place)
    words = (
        f'{len(run.samples)} samples over {run.samples.time[-1]:.1f} s in {arguments.out}, '
        f'tracker at ({place}) mm'
    )
    data = {
        'samples': len(run.samples),
        'duration_s': float(run.samples.time[-1]),
        'tracker_place': run.place.tolist(),
        'seed': config.seed,
        'out': arguments.out,
    }
    answer(arguments, words, data)
    return 0


def run_plan(arguments: argparse.Namespace) -> int:
    """Path for a machine, forecast of what it can see, NC program."""
    config = parameters(PlannerConfig, arguments)
    judged = parameters(ForecastConfig, arguments)
    from otf_core.model.machine import load_machine
    from otf_core.model.provenance import provenance
    from otf_core.noise.fields import read_noise
    from otf_core.planning.follow_up import measured_runs, open_questions
    from otf_core.planning.nc import DIALECTS
    from otf_core.planning.plan_report import PlanRequest, make_plan, read_place
    from otf_core.reports.plan_files import format_report, plan_summary, write_report

    given = (arguments.machine, arguments.path, arguments.noise, arguments.after)
    out = output_folder(arguments, *(name for name in given if name))
    machine = load_machine(arguments.machine)
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
    with progress_of(arguments, 'choosing lines', PLAN) as progress:
        report = make_plan(machine, request, config, judged, progress)
        progress('writing', 0.0)
        with out.filled('plan') as folder:
            files = write_report(report, folder, dialect, about)
    if dialect is None and not arguments.quiet:
        note(f'no NC program: give --dialect {"|".join(DIALECTS)} for one')
    words = format_report(report) if arguments.verbose else plan_summary(report)
    shown = next((f.name for f in files if f.name == 'report.html'), 'plan.svg')
    words += f'open {Path(arguments.out) / shown}; all numbers: --verbose, forecast.txt'
    answer_from(arguments, words, files, 'plan.json')
    return 0


def run_validate(arguments: argparse.Namespace) -> int:
    """The paper's comparisons on simulated cells."""
    from otf_core.reports.validation import write_validation
    from otf_core.sim.laboratory import SimulatedLaboratory
    from otf_core.validation.laboratory import scale
    from otf_core.validation.run import validate
    from otf_core.validation.table import format_rows

    out = output_folder(arguments)
    if arguments.cells is not None and not 1 <= arguments.cells <= MOST_CELLS:
        raise ConfigError(f'--cells: {arguments.cells} is out of range [1, {MOST_CELLS}]')
    laboratory, cells = (
        SimulatedLaboratory(),
        scale(arguments.quick, arguments.first_cell, arguments.cells),
    )
    found = validate(laboratory, cells, (lambda text: None) if arguments.quiet else note)
    truth = found.cells[0].reference.truth
    direct = laboratory.measure_directly(truth, found.seeds[0])
    with out.filled('validate') as folder:
        files = write_validation(found, direct, folder)
    answer_from(arguments, format_rows(found.rows) + '\n', files, 'validation.json')
    return told_limits(found.rows)


def told_limits(rows: Sequence[Row]) -> int:
    """Name the rows beyond their limits; the exit code."""
    failed = [row.quantity for row in rows if row.passed is False]
    for quantity in failed:
        note(f'otf: quality gate failed: {quantity}')
    return QUALITY_GATE_FAILED if failed else 0

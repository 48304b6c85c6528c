# SPDX-License-Identifier: Apache-2.0
"""Command line of the offline verbs; ``./otf VERB --help`` describes each.

Exit codes: 0 done, 1 internal error, 2 wrong usage or configuration, 3 input unusable, 4 done but
a quality gate failed.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from otf_core.cli_options import add_parameters, parameters
from otf_core.config import (
    CalibrationConfig,
    ForecastConfig,
    PlannerConfig,
    SimulationConfig,
)
from otf_core.errors import ConfigError, OtfError

QUALITY_GATE_FAILED = 4

LARGEST_SEED = 10_000_000
Handler = Callable[[argparse.Namespace], int]


def _seed(text: str) -> int:
    value = int(text)
    if not 0 <= value <= LARGEST_SEED:
        raise argparse.ArgumentTypeError(f'{value} is out of range [0, {LARGEST_SEED}]')
    return value


def _say(text: str) -> None:
    print(text, flush=True)


def _note(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _calibrate(arguments: argparse.Namespace) -> int:
    config = parameters(CalibrationConfig, arguments)
    from otf_core.calibrate import calibrate_runs
    from otf_core.io.bag import read_bag
    from otf_core.io.files import ensure_folder
    from otf_core.machine import load_machine
    from otf_core.results import format_result, write_calibration
    from otf_core.runs import Recording, prepare_runs
    from otf_core.standstill_method import prepare_stops

    prepare = {'otf': prepare_runs, 'standstill': prepare_stops}[arguments.method]
    machine = load_machine(arguments.machine)
    bag = read_bag(arguments.bag)
    try:
        recording = Recording(bag.samples, bag.path, machine)
        result = calibrate_runs([recording], config, prepare=prepare)
    except OtfError as error:
        raise type(error)(f'{arguments.bag}: {error}') from None
    files = write_calibration(result, ensure_folder(arguments.out))
    _say(format_result(result))
    _say('')
    _say(f'written: {", ".join(f.name for f in files)} in {arguments.out}')
    for gate in result.failed_gates:
        _note(f'otf: quality gate failed: {gate}')
    return QUALITY_GATE_FAILED if result.failed_gates else 0


def _predict(arguments: argparse.Namespace) -> int:
    import numpy as np

    from otf_core.io.csv_points import read_points_csv, write_csv
    from otf_core.io.files import ensure_folder
    from otf_core.prediction import predict

    points = read_points_csv(arguments.points)
    prediction = predict(arguments.tables, points)
    ensure_folder(Path(arguments.out).parent)
    columns = np.hstack([points, prediction.error, prediction.u])
    write_csv(arguments.out, 'x,y,z,dx,dy,dz,u_dx,u_dy,u_dz', columns)
    if not prediction.correlated:
        _note('otf predict: the tables hold no covariance; u takes their nodes as independent')
    return 0


def _listed(files: Sequence[Path], folder: str) -> str:
    return f'\nwritten: {", ".join(f.name for f in files)} in {folder}'


def _noise(arguments: argparse.Namespace) -> int:
    from otf_core.io.bag import read_points
    from otf_core.noise_files import format_noise, write_noise
    from otf_core.noise_report import noise_report

    speed = parameters(CalibrationConfig, arguments, ('standstill_speed',)).standstill_speed
    samples = read_points(arguments.bag)
    try:
        report = noise_report(samples, speed)
    except OtfError as error:
        raise type(error)(f'{arguments.bag}: {error}') from None
    files = write_noise(report, arguments.out)
    _say(format_noise(report) + '\n' + _listed(files, arguments.out))
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    from otf_core.comparison import compare, load_source
    from otf_core.comparison_report import format_comparison, write_comparison
    from otf_core.io.csv_points import read_points_csv
    from otf_core.machine import load_machine

    machine = load_machine(arguments.machine) if arguments.machine else None
    points = read_points_csv(arguments.points) if arguments.points else None
    a, b = load_source(arguments.a, machine), load_source(arguments.b, machine)
    result = compare(a, b, points)
    files = write_comparison(result, arguments.out)
    _say(format_comparison(result) + '\n' + _listed(files, arguments.out))
    return 0


def _validate(arguments: argparse.Namespace) -> int:
    from otf_core.io.files import ensure_folder
    from otf_core.sim.laboratory import SimulatedLaboratory
    from otf_core.validation.files import write_validation
    from otf_core.validation.laboratory import scale
    from otf_core.validation.run import validate
    from otf_core.validation.table import format_rows

    ensure_folder(arguments.out)
    laboratory, cells = SimulatedLaboratory(), scale(arguments.quick, arguments.first_cell)
    found = validate(laboratory, cells, _note)
    truth = found.cells[0].reference.truth
    direct = laboratory.measure_directly(truth, found.seeds[0])
    files = write_validation(found, direct, arguments.out)
    _say(format_rows(found.rows) + '\n' + _listed(files, arguments.out))
    failed = [row.quantity for row in found.rows if row.passed is False]
    for quantity in failed:
        _note(f'otf: quality gate failed: {quantity}')
    return QUALITY_GATE_FAILED if failed else 0


def _diagnose(arguments: argparse.Namespace) -> int:
    config = parameters(CalibrationConfig, arguments)
    from otf_core.diagnosis.complete import diagnose, write_diagnosis
    from otf_core.diagnosis.result import format_diagnosis
    from otf_core.effects import REGISTRY
    from otf_core.io.bag import read_bag
    from otf_core.io.files import ensure_folder
    from otf_core.machine import load_machine
    from otf_core.runs import Recording
    from otf_core.sim.twin import twin_recording

    unknown = sorted(set(arguments.exclude) - set(REGISTRY))
    if unknown:
        raise ConfigError(f'--exclude: {unknown[0]}: no effect; known: {", ".join(REGISTRY)}')
    machine = load_machine(arguments.machine)
    ensure_folder(arguments.out)
    recordings = []
    for name in arguments.bag:
        bag = read_bag(name)
        recordings.append(Recording(bag.samples, bag.path, machine))
    try:
        diagnosis, data = diagnose(
            recordings, arguments.bag, twin_recording, arguments.exclude, config
        )
    except OtfError as error:
        raise type(error)(f'{", ".join(arguments.bag)}: {error}') from None
    files = write_diagnosis(diagnosis, data, arguments.out, config)
    _say(format_diagnosis(diagnosis))
    _say(f'written: {", ".join(f.name for f in files)} in {arguments.out}')
    return 0


def _blind(arguments: argparse.Namespace) -> int:
    from otf_core.blind.trial import run_leave_one_out, run_trial

    run = run_leave_one_out if arguments.leave_one_out else run_trial
    _say(run(arguments.trials, arguments.seed, arguments.out, arguments.jobs, _note))
    return 0


def _plan_of(arguments: argparse.Namespace, config: PlannerConfig, machine: Any) -> Any:
    from otf_core.io.csv_points import read_points_csv
    from otf_core.path import NominalPath
    from otf_core.planning import check_inside, plan_for_path, plan_path

    if arguments.path is None:
        return plan_path(machine, config)
    try:
        path = NominalPath(read_points_csv(arguments.path))
        check_inside(path, machine)
    except ConfigError:
        raise
    except OtfError as error:
        raise ConfigError(f'{arguments.path}: {error}') from None
    return plan_for_path(path, config)


def _simulate(arguments: argparse.Namespace) -> int:
    config = parameters(SimulationConfig, arguments)
    planning = parameters(PlannerConfig, arguments)
    from otf_core.io.bag import BagContent, write_bag
    from otf_core.io.effects_yaml import read_effects
    from otf_core.io.files import ensure_folder
    from otf_core.machine import load_machine
    from otf_core.sim.cell import simulate
    from otf_core.tables import load_tables

    machine = load_machine(arguments.machine)
    effects = read_effects(arguments.effects, machine) if arguments.effects else ()
    tables = load_tables(arguments.tables).tables if arguments.tables else None
    if tables is not None:
        tables = dataclasses.replace(tables, machine=machine)
    plan = _plan_of(arguments, planning, machine)
    run = simulate(machine, plan, config, tables, effects)
    ensure_folder(Path(arguments.out).parent)
    write_bag(arguments.out, BagContent(run.samples, plan.path))
    _say(f'{len(run.samples)} samples over {run.samples.time[-1]:.1f} s in {arguments.out}')
    return 0


def _plan(arguments: argparse.Namespace) -> int:
    config = parameters(PlannerConfig, arguments)
    judged = parameters(ForecastConfig, arguments)
    from otf_core.io.files import check_folder, ensure_folder
    from otf_core.machine import load_machine
    from otf_core.nc import DIALECTS
    from otf_core.plan_report import format_report, write_report
    from otf_core.planning_job import PlanRequest, make_plan, read_noise, read_place

    machine = load_machine(arguments.machine)
    check_folder(arguments.out)
    place, wanted = arguments.tracker_place, arguments.wanted_uncertainty
    request = PlanRequest(
        given=None if arguments.path is None else _plan_of(arguments, config, machine),
        time_budget=arguments.time_budget,
        wanted_uncertainty=None if wanted is None else 1e-6 * wanted,
        tracker_place=None if place is None else read_place(place),
        noise=None if arguments.noise is None else read_noise(arguments.noise),
    )
    report = make_plan(machine, request, config, judged)
    dialect = None if arguments.dialect is None else DIALECTS[arguments.dialect]
    files = write_report(report, ensure_folder(arguments.out), dialect)
    _say(format_report(report))
    _say(f'written: {", ".join(f.name for f in files)} in {arguments.out}')
    if dialect is None:
        _say(f'no NC program: give --dialect {"|".join(DIALECTS)} for one')
    return 0


class _Parser(argparse.ArgumentParser):
    """One clear line instead of the usage text in front of every error."""

    def error(self, message: str) -> Any:
        """Print what is wrong and leave with exit code 2."""
        self.exit(2, f'{self.prog}: {message} (see {self.prog} --help)\n')


def _add_plan_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        '--time-budget', type=float, metavar='S',
        help='choose lines, passes and feeds up to --feed so that the grid is known best after '
        'this time, accelerations and dwells included; --passes, --feed-ratio and --levels do '
        'not count then (s)',
    )  # fmt: skip
    sub.add_argument(
        '--wanted-uncertainty', type=float, metavar='UM',
        help='the same for a forecast mean grid uncertainty in a short time (um, k = 1)',
    )  # fmt: skip
    sub.add_argument(
        '--tracker-place', metavar='X,Y,Z',
        help='beam origin of the tracker in the machine frame (m; default in front, at -Y)',
    )  # fmt: skip
    sub.add_argument('--noise', help='noise.json of otf noise; as in machine.yaml if not given')
    sub.add_argument(
        '--dialect', choices=('sinumerik', 'fanuc', 'heidenhain', 'linuxcnc'),
        help='write the NC program for this control; there is no generic one',
    )  # fmt: skip


def _add_judging_verbs(verb: Callable[[str, Handler, str], argparse.ArgumentParser]) -> None:
    """Verbs that judge a tracker, a calibration or this program."""
    sub = verb('noise', _noise, 'Tracker noise in the standstills of a bag.')
    sub.add_argument('bag', help='rosbag2 folder or .mcap file; /tracker/point suffices')
    sub.add_argument('--out', required=True, help='folder for the results')
    add_parameters(sub, CalibrationConfig, ('standstill_speed',))

    sub = verb('compare', _compare, 'Error tables or direct measurements, motion by motion.')
    sub.add_argument('a', help='error_tables.json, or CSV of a direct measurement')
    sub.add_argument('b', help='the same')
    sub.add_argument('--machine', help='machine.yaml, for direct measurements')
    sub.add_argument('--points', help='CSV with the header x,y,z; a grid if not given')
    sub.add_argument('--out', required=True, help='folder for the results')

    sub = verb('validate', _validate, "The paper's comparisons on simulated cells.")
    sub.add_argument('--out', required=True, help='folder for table and figures')
    sub.add_argument('--quick', action='store_true', help='two cells instead of eight')
    sub.add_argument(
        '--seed', dest='first_cell', type=_seed, default=2001, metavar='N',
        help='of the first cell (default 2001)',
    )  # fmt: skip

    sub = verb('blind', _blind, 'Blind trial: draw and seal cells, diagnose them, score.')
    sub.add_argument('--trials', type=int, required=True, help='cells to draw')
    sub.add_argument('--seed', type=int, required=True, help='all random numbers hang on it')
    sub.add_argument('--out', required=True, help='folder; an interrupted trial goes on there')
    sub.add_argument('--jobs', type=int, default=2, help='processes at once (default 2)')
    sub.add_argument(
        '--leave-one-out',
        action='store_true',
        help='every effect diagnosed with itself taken out of the catalogue',
    )


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog='otf', description='On-the-fly machine-tool calibration, offline verbs.')
    verbs = parser.add_subparsers(dest='verb', metavar='VERB', required=True)

    def verb(name: str, handler: Handler, text: str) -> argparse.ArgumentParser:
        sub: argparse.ArgumentParser = verbs.add_parser(name, help=text, description=text)
        sub.set_defaults(handler=handler)
        return sub

    sub = verb('calibrate', _calibrate, 'Error tables from a recorded bag.')
    sub.add_argument('bag', help='rosbag2 folder or .mcap file')
    sub.add_argument('--machine', required=True, help='machine.yaml')
    sub.add_argument('--out', required=True, help='folder for the results')
    sub.add_argument('--method', choices=('otf', 'standstill'), default='otf')
    add_parameters(sub, CalibrationConfig)

    sub = verb('diagnose', _diagnose, 'Where and why a real run departs from its simulation.')
    sub.add_argument('bag', nargs='+', help='runs of one machine: other station, feed or time')
    sub.add_argument('--machine', required=True, help='machine.yaml')
    sub.add_argument('--out', required=True, help='folder for gap.json and report.html')
    sub.add_argument(
        '--exclude', action='append', default=[], metavar='EFFECT', help='leave an effect out'
    )
    add_parameters(sub, CalibrationConfig)

    sub = verb('predict', _predict, 'Volumetric errors at points, from error tables.')
    sub.add_argument('--tables', required=True, help='error_tables.json')
    sub.add_argument('--points', required=True, help='CSV with the header x,y,z; m')
    sub.add_argument('--out', required=True, help='CSV x,y,z,dx,dy,dz,u_dx,u_dy,u_dz; m, k = 1')

    _add_judging_verbs(verb)

    sub = verb('plan', _plan, 'Path for a machine, forecast of what it can see, NC program.')
    sub.add_argument('--machine', required=True, help='machine.yaml')
    sub.add_argument('--out', required=True, help='folder for path, forecast and program')
    sub.add_argument('--path', help='CSV with the header x,y,z: take this path instead')
    _add_plan_options(sub)
    add_parameters(sub, PlannerConfig)
    add_parameters(sub, ForecastConfig)

    sub = verb('simulate', _simulate, 'Bag of a simulated run.')
    sub.add_argument('--machine', required=True, help='machine.yaml')
    sub.add_argument('--out', required=True, help='bag folder to write')
    sub.add_argument('--tables', help='error_tables.json of the truth; drawn if not given')
    sub.add_argument('--path', help='CSV with the header x,y,z; planned if not given')
    sub.add_argument('--effects', help='effects.yaml: what to add to the cell')
    add_parameters(sub, SimulationConfig)
    add_parameters(sub, PlannerConfig)
    return parser


def _joined(argv: Sequence[str]) -> list[str]:
    """Join --tracker-place with its value: argparse takes '-0.3,0,0' for an option."""
    joined: list[str] = []
    for word in argv:
        if joined and joined[-1] == '--tracker-place':
            joined[-1] += '=' + word
        else:
            joined.append(word)
    return joined


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; return the exit code."""
    arguments = _parser().parse_args(_joined(sys.argv[1:] if argv is None else argv))
    try:
        return int(arguments.handler(arguments))
    except OtfError as error:
        _note(f'otf {arguments.verb}: {error}')
        return error.exit_code
    except KeyboardInterrupt:
        _note(f'otf {arguments.verb}: interrupted')
        return 130
    except BrokenPipeError:
        sys.stderr.close()
        return 0


if __name__ == '__main__':
    sys.exit(main())

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

from otf_core.config import (
    CalibrationConfig,
    ParameterInfo,
    Parameters,
    PlannerConfig,
    SimulationConfig,
)
from otf_core.errors import ConfigError, OtfError

QUALITY_GATE_FAILED = 4

CLI_UNITS = {'feed': ('MM_PER_MIN', 60000.0)}
"""Options stated in another unit than the parameter, as machine users do: name, factor."""

Handler = Callable[[argparse.Namespace], int]


def _option(name: str) -> str:
    return '--' + name.replace('_', '-')


def _add_parameter(group: Any, info: ParameterInfo) -> None:
    kind = type(info.default)
    unit, factor = CLI_UNITS.get(info.name, (kind.__name__.upper(), 1))
    bounds = ''
    if info.low is not None and info.high is not None:
        bounds = f', {info.low * factor:g} to {info.high * factor:g}'
    stated = info.unit if factor == 1 else 'mm/min'
    default = info.default if isinstance(info.default, str) else info.default * factor
    text = f'{info.meaning} ({stated or kind.__name__}{bounds}; default {default})'
    group.add_argument(
        _option(info.name),
        dest=info.name,
        type=kind,
        choices=info.choices or None,
        metavar=unit,
        help=text.replace('%', '%%'),
    )


def _add_parameters(parser: argparse.ArgumentParser, kind: type[Parameters]) -> None:
    group = parser.add_argument_group((kind.__doc__ or '').split('.')[0].lower())
    for info in kind.infos():
        _add_parameter(group, info)


def _parameters(kind: type[Any], arguments: argparse.Namespace) -> Any:
    """Build a parameter dataclass from the options that were given."""
    given = {}
    for info in kind.infos():
        value = getattr(arguments, info.name)
        if value is None:
            continue
        try:
            scale = CLI_UNITS.get(info.name, ('', 1))[1]
            given[info.name] = info.check(value if scale == 1 else value / scale)
        except ConfigError as error:
            raise ConfigError(f'{_option(info.name)}{str(error)[len(info.name) :]}') from None
    return kind(**given)


def _say(text: str) -> None:
    print(text, flush=True)


def _note(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _calibrate(arguments: argparse.Namespace) -> int:
    config = _parameters(CalibrationConfig, arguments)
    from otf_core.calibrate import calibrate
    from otf_core.io.bag import read_bag
    from otf_core.io.files import ensure_folder
    from otf_core.machine import load_machine
    from otf_core.results import format_result, write_calibration

    if arguments.method != 'otf':
        raise ConfigError('--method standstill: not available yet; use --method otf')
    machine = load_machine(arguments.machine)
    bag = read_bag(arguments.bag)
    try:
        result = calibrate(bag.samples, bag.path, machine, config)
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
    config = _parameters(SimulationConfig, arguments)
    planning = _parameters(PlannerConfig, arguments)
    from otf_core.io.bag import BagContent, write_bag
    from otf_core.io.files import ensure_folder
    from otf_core.machine import load_machine
    from otf_core.sim.cell import simulate
    from otf_core.tables import load_tables

    if arguments.effects is not None:
        raise ConfigError('--effects: not available yet')
    machine = load_machine(arguments.machine)
    tables = load_tables(arguments.tables).tables if arguments.tables else None
    if tables is not None:
        tables = dataclasses.replace(tables, machine=machine)
    plan = _plan_of(arguments, planning, machine)
    run = simulate(machine, plan, config, tables)
    ensure_folder(Path(arguments.out).parent)
    write_bag(arguments.out, BagContent(run.samples, plan.path))
    _say(f'{len(run.samples)} samples over {run.samples.time[-1]:.1f} s in {arguments.out}')
    return 0


def _plan(arguments: argparse.Namespace) -> int:
    config = _parameters(PlannerConfig, arguments)
    from otf_core.io.csv_points import write_csv
    from otf_core.io.files import ensure_folder
    from otf_core.machine import load_machine

    machine = load_machine(arguments.machine)
    plan = _plan_of(arguments, config, machine)
    folder = ensure_folder(arguments.out)
    write_csv(folder / 'path.csv', 'x,y,z', plan.path.points)
    _say(
        f'{len(plan.path.points)} points, {plan.path.length:.2f} m, {plan.duration:.0f} s: '
        f'{folder / "path.csv"}'
    )
    return 0


class _Parser(argparse.ArgumentParser):
    """One clear line instead of the usage text in front of every error."""

    def error(self, message: str) -> Any:
        """Print what is wrong and leave with exit code 2."""
        self.exit(2, f'{self.prog}: {message} (see {self.prog} --help)\n')


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
    _add_parameters(sub, CalibrationConfig)

    sub = verb('predict', _predict, 'Volumetric errors at points, from error tables.')
    sub.add_argument('--tables', required=True, help='error_tables.json')
    sub.add_argument('--points', required=True, help='CSV with the header x,y,z; m')
    sub.add_argument('--out', required=True, help='CSV x,y,z,dx,dy,dz,u_dx,u_dy,u_dz; m, k = 1')

    sub = verb('plan', _plan, 'Nominal path for a machine.')
    sub.add_argument('--machine', required=True, help='machine.yaml')
    sub.add_argument('--out', required=True, help='folder for the path')
    sub.add_argument('--path', help='CSV with the header x,y,z: take this path instead')
    _add_parameters(sub, PlannerConfig)

    sub = verb('simulate', _simulate, 'Bag of a simulated run.')
    sub.add_argument('--machine', required=True, help='machine.yaml')
    sub.add_argument('--out', required=True, help='bag folder to write')
    sub.add_argument('--tables', help='error_tables.json of the truth; drawn if not given')
    sub.add_argument('--path', help='CSV with the header x,y,z; planned if not given')
    sub.add_argument('--effects', help='effects.yaml')
    _add_parameters(sub, SimulationConfig)
    _add_parameters(sub, PlannerConfig)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; return the exit code."""
    arguments = _parser().parse_args(argv)
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

# SPDX-License-Identifier: Apache-2.0
"""Demonstration: calibrates a simulated machine with the real nodes and compares with the truth.

Planner, tracker driver and calibrator run as processes of their own, as with the launch files. The
errors of the machine are drawn here and given to the driver only; the calibrator never sees them.
With ``--diagnose`` the run is diagnosed as well, with ``--effects`` there is something to find.
With ``--view`` a page in the browser shows how it goes. ``--machine five-axis`` takes a small
trunnion machine, whose reflector is moved by hand from the spindle to three places on the table.
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ament_index_python.packages import get_package_share_directory

from otf_bringup import view
from otf_bringup.domain import free_domain
from otf_bringup.processes import NodeProcess, end_together, module_of
from otf_core.effects.effects_yaml import read_effects
from otf_core.errors import ConfigError, OtfError
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.chain import Sight, displacement, exact_position
from otf_core.model.evaluation import evenly_spread, lattice, without_rigid_motion
from otf_core.model.expanded import COVERAGE_FACTOR, micro_figure, micro_significant
from otf_core.model.machine import SPINDLE, TABLE, load_machine
from otf_core.model.motions import unit_of
from otf_core.model.tables import ErrorTables
from otf_core.prediction.calibration_document import load_tables, tables_to_dict
from otf_core.sim.cell import random_tables
from otf_core.solving.tabulate import remove_rigid_motions
from otf_msgs.msg import CalibrationResult, GapReport

ERROR_SIZE = 1e-4
"""m; mean volumetric error of the simulated machine."""
RATE, ROTARY_RATE = 500.0, 200.0
"""Hz; of a machine with rotary axes, whose run takes longer."""
SPEED, ROTARY_SPEED = 10.0, 20.0
"""Times as fast as measured."""
PLACES = 1000
"""Positions of all axes at which errors are compared."""
FIVE_AXIS = 'five-axis'
"""Name of a machine that comes along."""


class DemoError(OtfError):
    """The node graph did not do what it should."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demonstration; returns the exit code."""
    options = _options(arguments)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        return _run(options)
    except KeyboardInterrupt:
        print('\ninterrupted; all nodes ended', file=sys.stderr)
        return 130
    except OtfError as error:
        print(f'\ndemo: {error}', file=sys.stderr)
        return error.exit_code


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    share = Path(get_package_share_directory('otf_bringup'))
    parser = argparse.ArgumentParser(
        prog='otf demo',
        description=__doc__.splitlines()[0],
        epilog='Example: ./otf demo --view --seed 3',
    )
    parser.add_argument(
        '--out', type=Path, default=Path('demo_output'), help='folder for all files (%(default)s)'
    )
    parser.add_argument(
        '--seed', type=int, default=7, help='seed of errors and noise (%(default)s)'
    )
    parser.add_argument(
        '--machine', type=Path, default=share / 'config' / 'machine.yaml',
        help='machine.yaml; or five-axis: a small trunnion machine',
    )  # fmt: skip
    parser.add_argument(
        '--effects', type=Path, help='effects.yaml: what else is wrong in the simulated cell'
    )
    parser.add_argument(
        '--diagnose', action='store_true', help='also diagnose the run; takes 20 s more'
    )
    parser.add_argument(
        '--view', action='store_true', help='show the run in the browser while it is driven'
    )
    options = parser.parse_args(arguments)
    if options.machine == Path(FIVE_AXIS):
        options.machine = share / 'config' / f'{FIVE_AXIS}.yaml'
    return options


def _run(options: argparse.Namespace) -> int:
    started = time.monotonic()
    out = ensure_folder(options.out).absolute()
    ensure_folder(out / 'log')
    truth = _prepare(out, options)
    with free_domain() as domain:
        environment = {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
        print(
            f'{truth.machine.name}, chain {truth.machine.chain}: planner, tracker driver and '
            f'calibrator on ROS_DOMAIN_ID={domain}\n',
            flush=True,
        )
        nodes = _start(out, options, environment, rotary=bool(truth.machine.rotary_names))
        with end_together(nodes):
            from otf_bringup.monitor import monitor_run

            address = view.open_page(nodes[0]) if options.view else ''
            if address:
                print(f'Live view: {address}\n', flush=True)
            result, stream, gap = monitor_run(domain, nodes, options.diagnose)
            took = time.monotonic() - started
            if result.run_id:
                (_report_axes if truth.machine.rotary_names else _report)(truth, result)
            if result.run_id and gap:
                _report_gap(gap)
            if address:
                view.keep_open(address)
    if not result.run_id:
        raise DemoError(f'calibration failed: {result.message}\nlogs: {out / "log"}')
    print(
        f'Took {took:.0f} s; the machine was simulated at {stream.real_time_factor:.3g} times '
        f'its speed.'
    )
    return int(result.status or (gap.status if gap else 0))


def _prepare(out: Path, options: argparse.Namespace) -> ErrorTables:
    """Write the machine description and the true errors; return the latter."""
    machine_file, seed = options.machine, options.seed
    machine = load_machine(machine_file)
    if seed < 0:
        raise ConfigError(f'--seed: {seed} is negative')
    if options.effects:
        read_effects(options.effects, machine)
    truth = random_tables(machine, ERROR_SIZE, np.random.default_rng(seed))
    if machine_file.resolve() != (out / 'machine.yaml').resolve():
        shutil.copyfile(machine_file, out / 'machine.yaml')
    write_text(out / 'truth.json', json.dumps(tables_to_dict(truth), indent=1) + '\n')
    return truth


def _start(
    out: Path, options: argparse.Namespace, environment: dict[str, str], *, rotary: bool
) -> list[NodeProcess]:
    """Start the nodes; what shows them first."""
    machine = {'machine_file': out / 'machine.yaml'}
    rate = ROTARY_RATE if rotary else RATE
    simulation = {'rate': rate, 'seed': options.seed, 'truth_tables': out / 'truth.json'}
    if options.effects:
        simulation['effects'] = options.effects.absolute()
    simulated = {f'simulated.{name}': value for name, value in simulation.items()}
    results = {'output_directory': out / 'calibrations', 'diagnose': options.diagnose}
    speed = {'time_scale': ROTARY_SPEED if rotary else SPEED}
    short = {'levels': 2} if rotary else {}
    shown = {'page': {'port': 0}, 'viewer': {}} if options.view else {}
    given: dict[str, dict[str, Any]] = {
        **shown,
        'path_planner': {**machine, **short},
        'calibrator': {**machine, **results},
        'tracker_driver': {**machine, **simulated, **speed},
    }
    nodes: list[NodeProcess] = []
    try:
        for name, parameters in given.items():
            module = module_of(name)
            nodes.append(NodeProcess(name, module, parameters, out / 'log', environment))
    except BaseException:  # an interrupt too: no node outlives the demo
        with end_together(nodes):
            raise
    return nodes


def _report(truth: ErrorTables, result: CalibrationResult) -> None:
    """Print verdicts, headline, what is left of the errors on the same grid, what was lost."""
    folder = Path(result.output_directory)
    calibrated = load_tables(folder / 'error_tables.json')
    q = lattice(truth.machine)
    before = exact_position(truth, q) - q
    fields = before, before - displacement(calibrated.tables, q)
    lengths = [np.linalg.norm(without_rigid_motion(field, q), axis=1) for field in fields]
    alone = calibrated.headline.observed
    print(result.message)
    print(f'\nAgainst the true errors of this simulation, on the same {len(q)} points:')
    for when, length in zip(('as it stands', 'compensated'), lengths, strict=True):
        mean, largest = (
            micro_figure(size(), alone[name])
            for size, name in ((length.mean, 'mean'), (length.max, 'max'))
        )
        print(f'  {when}: mean {mean}, largest {largest}')
    print(
        f'  The simulated tracker has noise and nothing systematic, so U of noise and misfit '
        f'alone holds here: mean {micro_significant(alone["mean"])}, largest '
        f'{micro_significant(alone["max"])}.'
    )
    _report_end(result, folder)


def _report_axes(truth: ErrorTables, result: CalibrationResult) -> None:
    """Print verdict and headline of a machine with rotary axes, and what is left of the errors."""
    folder, machine = Path(result.output_directory), truth.machine
    tables = load_tables(folder / 'error_tables.json').tables
    q = evenly_spread(machine.lower, machine.upper, PLACES)
    sight = Sight(machine, TABLE, SPINDLE, np.array(machine.target_offset))
    before = exact_position(truth, q, sight) - sight.nominal(q)
    print(result.message)
    print(f'\nAgainst the true errors of this simulation, at {len(q)} positions of all axes:')
    for when, field in (
        ('as it stands', before),
        ('compensated', before - displacement(tables, q)),
    ):
        free = remove_rigid_motions(machine, q, field.reshape(-1, 1)).reshape(-1, 3)
        length = np.linalg.norm(free, axis=1)
        mean, largest = (1e6 * float(size()) for size in (length.mean, length.max))
        print(f'  {when}: mean {mean:.2f} um, largest {largest:.2f} um')
    print('Where the lines of the rotary axes lie (U, k = 2):')
    wide = COVERAGE_FACTOR * 1e6
    for name, value, u in zip(
        result.location, result.location_value, result.location_u, strict=True
    ):
        print(f'  {name}: {1e6 * value:.2f} +/- {wide * u:.2f} u{unit_of(name)}')
    if result.not_identifiable:
        print(f'Not determined: {", ".join(result.not_identifiable)}; the report says why.')
    _report_end(result, folder)


def _report_end(result: CalibrationResult, folder: Path) -> None:
    """Print what was lost, and where the files are."""
    if result.samples_lost:
        share = 100 * result.samples_lost / (result.samples + result.samples_lost)
        print(f'{result.samples_lost} samples ({share:.1f} %) were lost on the way.')
    print(f'Report: {folder / "report.html"}')


def _report_gap(gap: GapReport) -> None:
    """Print what the diagnosis says."""
    if gap.status != GapReport.OK:
        print(f'Diagnosis failed: {gap.message}')
        return
    print(
        f'Diagnosis: {gap.verdict}. {gap.message}\n{gap.where}\n'
        f'Report: {Path(gap.output_directory) / "gap_report.html"}'
    )


if __name__ == '__main__':
    sys.exit(main())

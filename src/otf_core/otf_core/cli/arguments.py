# SPDX-License-Identifier: Apache-2.0
"""Arguments of the verbs; exporting, closing, plant and keeping add those of their own."""

from __future__ import annotations

import argparse

from otf_core.cli.checking import run_check, run_doctor, run_info
from otf_core.cli.completion import SHELLS, run_completion
from otf_core.cli.measuring import (
    run_calibrate,
    run_compare,
    run_diagnose,
    run_noise,
    run_predict,
)
from otf_core.cli.options import AddVerb, add_out, add_parameters, add_reading, add_verbose
from otf_core.cli.plant import run_blind
from otf_core.cli.simulating import run_plan, run_simulate, run_validate
from otf_core.config import (
    METHODS,
    OTF,
    CalibrationConfig,
    ForecastConfig,
    PlannerConfig,
    SimulationConfig,
)
from otf_core.planning.nc import DIALECTS

LARGEST_SEED = 10_000_000


def _seed(text: str) -> int:
    value = int(text)
    if not 0 <= value <= LARGEST_SEED:
        raise argparse.ArgumentTypeError(f'{value} is out of range [0, {LARGEST_SEED}]')
    return value


def add_checking_verbs(verb: AddVerb) -> None:
    """Verbs that answer in seconds."""
    sub = verb('check', run_check)
    sub.add_argument('bag', help='rosbag2 folder, .mcap file or table of samples as text')
    sub.add_argument(
        '--machine', help='machine.yaml: also its axes, its noise, and a forecast of u'
    )
    add_reading(sub)
    add_parameters(sub, CalibrationConfig, ('match_tolerance', 'standstill_speed'))

    sub = verb('info', run_info)
    sub.add_argument('file', help='a file or folder that otf wrote or reads')

    verb('doctor', run_doctor)

    sub = verb('completion', run_completion)
    sub.add_argument('shell', choices=SHELLS)


def _add_runs(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        'bag', nargs='+',
        help='rosbag2 folders, .mcap files or tables of samples as text: runs of one machine, '
        'e.g. with other stations, feeds or target offsets',
    )  # fmt: skip
    sub.add_argument(
        '--machine', required=True, action='append', metavar='M.yaml',
        help='machine.yaml of all bags; or given once per bag, in their order',
    )  # fmt: skip
    sub.add_argument(
        '--signal', action='append', default=[], metavar='TOPIC[:FIELD]',
        help='a number recorded beside the samples, such as a temperature, that a diagnosis takes '
        'for a possible cause; may be repeated',
    )  # fmt: skip
    sub.add_argument(
        '--join', action='store_true',
        help='the bags are parts of one run, whose recording was ended and begun again',
    )  # fmt: skip
    add_reading(sub)


def _add_calibrate_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        '--method', choices=METHODS, default=OTF,
        help=f'on the fly, or from the stops at the corner points alone (default {OTF})',
    )  # fmt: skip
    sub.add_argument(
        '--effects', metavar='auto|FILE',
        help='take effects off and state u with them: what a diagnosis finds, or those of an '
        'effects.yaml, their coefficients estimated anew where the data see them; the plain '
        'calibration stays in plain/',
    )  # fmt: skip
    sub.add_argument(
        '--residuals-csv', action='store_true', help='write residuals.csv beside residuals.npz'
    )
    sub.add_argument(
        '--certificate', action='store_true',
        help='write certificate.html too: two pages for print; customer, number and the like come '
        'from the sections certificate, instrument and conditions of machine.yaml',
    )  # fmt: skip
    sub.add_argument(
        '--no-report', dest='report', action='store_false', help='leave report.html out'
    )


def _add_diagnose(verb: AddVerb) -> None:
    """Why runs depart from their simulation."""
    sub = verb('diagnose', run_diagnose)
    _add_runs(sub)
    add_out(sub, 'folder for gap.json and report.html')
    sub.add_argument(
        '--exclude', action='append', default=[], metavar='EFFECT', help='leave an effect out'
    )
    sub.add_argument(
        '--own-causes', metavar='DIR',
        help='folder of named empirical effects (.yaml), tried beside the catalogue',
    )  # fmt: skip
    add_parameters(sub, CalibrationConfig)


def _add_predict_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument('--tables', required=True, help='error_tables.json')
    sub.add_argument(
        '--points',
        required=True,
        help='CSV with the header x,y,z in m, or a text that states its units',
    )
    add_out(sub, 'CSV x,y,z,dx,dy,dz,u_dx,u_dy,u_dz,inside; m, k = 1')
    sub.add_argument(
        '--target-offset', type=float, nargs=3, metavar=('X', 'Y', 'Z'),
        help='predict for this target offset, e.g. of a longer tool (m; default: as measured); '
        'rotations that the data do not see are in u by their prior',
    )  # fmt: skip


def add_measuring_verbs(verb: AddVerb) -> None:
    """Verbs that work on recordings, and on the tables that come of them."""
    sub = verb('calibrate', run_calibrate)
    _add_runs(sub)
    add_out(sub, 'folder for the results')
    _add_calibrate_options(sub)
    add_verbose(sub, 'summary.txt')
    add_parameters(sub, CalibrationConfig)

    _add_diagnose(verb)

    sub = verb('predict', run_predict)
    _add_predict_options(sub)


def add_judging_verbs(verb: AddVerb) -> None:
    """Verbs that judge a tracker, a calibration or this program."""
    sub = verb('noise', run_noise)
    sub.add_argument('bag', help='rosbag2 folder or .mcap file; /tracker/point suffices')
    add_out(sub, 'folder for the results')
    add_reading(sub, path=False)
    add_parameters(sub, CalibrationConfig, ('standstill_speed',))

    sub = verb('compare', run_compare)
    sub.add_argument(
        'a',
        help='error_tables.json, or CSV of a direct measurement with the head '
        'axis,run,direction,position_m,EX_m,EY_m,EZ_m,EA_rad,EB_rad,EC_rad, one row a reading '
        '(direction: forward or backward; units m, mm, um, rad, urad, arcsec by the head; columns '
        'that the instrument lacks left out)',
    )
    sub.add_argument('b', help='the same')
    sub.add_argument('--machine', help='machine.yaml, for direct measurements')
    sub.add_argument('--points', help='CSV with the header x,y,z; a grid if not given')
    add_out(sub, 'folder for the results')

    sub = verb('validate', run_validate)
    add_out(sub, 'folder for table and figures')
    sub.add_argument(
        '--quick', action='store_true', help='two cells instead of eight, and shorter stops'
    )
    sub.add_argument('--cells', type=int, metavar='N', help='so many cells')
    sub.add_argument(
        '--seed', dest='first_cell', type=_seed, default=2001, metavar='N',
        help='of the first cell (default 2001)',
    )  # fmt: skip

    sub = verb('blind', run_blind)
    sub.add_argument('--trials', type=int, required=True, help='cells to draw')
    sub.add_argument('--seed', type=int, required=True, help='seed of all random draws')
    add_out(sub, 'folder; an interrupted trial goes on there')
    sub.add_argument('--jobs', type=int, default=2, help='processes at once (default 2)')
    sub.add_argument(
        '--leave-one-out',
        action='store_true',
        help='every effect diagnosed with itself taken out of the catalogue',
    )


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
        '--dialect', choices=tuple(DIALECTS),
        help='write the NC program for this control; there is no generic one',
    )  # fmt: skip


def add_planning_verbs(verb: AddVerb) -> None:
    """Verbs that come before a measurement, or stand for one."""
    sub = verb('plan', run_plan)
    sub.add_argument('--machine', required=True, help='machine.yaml')
    add_out(sub, 'folder for path, forecast and program')
    add_verbose(sub, 'forecast.txt')
    sub.add_argument('--path', help='CSV x,y,z, plan.json or NC program: take this path instead')
    sub.add_argument(
        '--after', metavar='DIR',
        help='folder of a diagnosis: the shortest path, up to --time-budget, that tells apart '
        'what it could not',
    )  # fmt: skip
    _add_plan_options(sub)
    add_parameters(sub, PlannerConfig)
    add_parameters(sub, ForecastConfig)

    sub = verb('simulate', run_simulate)
    sub.add_argument('--machine', required=True, help='machine.yaml')
    add_out(sub, 'bag folder to write, or .mcap file; its truth lies in or beside it')
    sub.add_argument('--tables', help='error_tables.json of the truth; drawn if not given')
    sub.add_argument(
        '--path',
        help='CSV x,y,z or NC program; or plan.json of otf plan: its feeds and dwells, and the '
        'tracker where its forecast puts it; planned if not given',
    )
    sub.add_argument('--effects', help='effects.yaml: what to add to the cell')
    add_parameters(sub, SimulationConfig)
    add_parameters(sub, PlannerConfig)

# SPDX-License-Identifier: Apache-2.0
"""Arguments of the verbs; exporting, plant and keeping add those of their own."""

from __future__ import annotations

import argparse

from otf_core.cli.doctor import run_doctor
from otf_core.cli.info import run_info
from otf_core.cli.measuring import (
    run_calibrate,
    run_check,
    run_compare,
    run_diagnose,
    run_noise,
    run_predict,
)
from otf_core.cli.options import (
    AddVerb,
    add_config,
    add_out,
    add_parameters,
    add_reading,
    add_sign,
)
from otf_core.cli.parser import SHELLS, run_completion
from otf_core.cli.simulating import run_plan, run_simulate
from otf_core.config import (
    METHODS,
    OTF,
    POINTS,
    PlannerConfig,
    SimulationConfig,
)
from otf_core.planning.nc import DIALECTS


def add_checking_verbs(verb: AddVerb) -> None:
    """Verbs that answer in seconds."""
    sub = verb('check', run_check)
    sub.add_argument('bag', help='rosbag2 folder, .mcap file or table of samples as text')
    sub.add_argument(
        '--machine', help='machine.yaml: adds checks of axes and noise, and a forecast of u'
    )
    add_reading(sub)
    add_config(sub, 'check')

    sub = verb('info', run_info)
    sub.add_argument('file', help='recording, machine.yaml, lattice, or result of otf')

    verb('doctor', run_doctor)

    sub = verb('completion', run_completion)
    sub.add_argument('shell', choices=SHELLS)


def _add_runs(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        'bag', nargs='+',
        help='runs of one machine: rosbag2 folders, .mcap files or text tables',
    )  # fmt: skip
    sub.add_argument(
        '--machine', required=True, action='append', metavar='M.yaml',
        help='machine.yaml of all bags, or one per bag in order',
    )  # fmt: skip
    sub.add_argument(
        '--join', action='store_true',
        help='the bags are parts of one interrupted recording',
    )  # fmt: skip
    sub.add_argument(
        '--same-station', action='store_true',
        help='tracker not moved between bags (one target offset)',
    )  # fmt: skip
    add_reading(sub)


def _add_calibrate_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        '--method', choices=(*METHODS, POINTS), default=OTF,
        help=f'from stops at corners; from pairs of points in place of bags (default {OTF})',
    )  # fmt: skip
    sub.add_argument(
        '--effects', metavar='auto|FILE',
        help='take effects off, with their u: those that a diagnosis finds, or those of an '
        'effects.yaml; plain/ keeps the calibration without',
    )  # fmt: skip


def _add_diagnose(verb: AddVerb) -> None:
    """Why runs depart from their simulation."""
    sub = verb('diagnose', run_diagnose)
    _add_runs(sub)
    add_out(sub, 'folder for gap.json and report.html')
    add_config(sub, 'diagnose')


def _add_predict_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument('--tables', required=True, help='error_tables.json')
    sub.add_argument(
        '--points',
        required=True,
        help='CSV with the header x,y,z in m, or a text table that states its units',
    )
    add_out(sub, 'CSV x,y,z,dx,dy,dz,u_dx,u_dy,u_dz,u_run_dx,...,inside; m, k = 1; no u outside')
    sub.add_argument(
        '--target-offset', type=float, nargs=3, metavar=('X', 'Y', 'Z'),
        help='predict for this target offset, e.g. of a longer tool (m; default: as measured); '
        'u includes rotations that the data do not determine',
    )  # fmt: skip


def add_measuring_verbs(verb: AddVerb) -> None:
    """Verbs that work on recordings, and on the tables that come of them."""
    sub = verb('calibrate', run_calibrate)
    _add_runs(sub)
    add_out(sub, 'folder for the results')
    _add_calibrate_options(sub)
    add_config(sub, 'calibrate')

    _add_diagnose(verb)

    sub = verb('predict', run_predict)
    _add_predict_options(sub)


def add_judging_verbs(verb: AddVerb) -> None:
    """Verbs that judge a tracker, a calibration or this program."""
    sub = verb('noise', run_noise)
    sub.add_argument('bag', help='rosbag2 folder or .mcap file; the topic /tracker/point suffices')
    add_out(sub, 'folder for the results')
    add_reading(sub, path=False)
    add_config(sub, 'noise')

    sub = verb('compare', run_compare)
    sub.add_argument(
        'a',
        help='error_tables.json, or CSV of a direct measurement with the header '
        'axis,run,direction,position_m,EX_m,EY_m,EZ_m,EA_rad,EB_rad,EC_rad, one row per reading '
        '(direction: forward or backward; units m, mm, um, rad, urad, arcsec as in the header; '
        'of rotary axes position_deg; omit columns that the instrument does not measure)',
    )
    sub.add_argument('b', help='the same; or tables of another system, as otf import reads them')
    sub.add_argument('--machine', help='machine.yaml, of what does not hold its machine')
    add_sign(sub)
    sub.add_argument('--points', help='CSV: x,y,z and rotary letters (default: a grid)')
    add_out(sub, 'folder for the results')


def _add_plan_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        '--time-budget', type=float, metavar='S',
        help='choose lines, passes and feeds up to --feed for the smallest grid uncertainty '
        'within this time (s)',
    )  # fmt: skip
    sub.add_argument(
        '--wanted-uncertainty', type=float, metavar='UM',
        help='choose lines, passes and feeds that reach this mean grid uncertainty in a short '
        'time (um, k = 1)',
    )  # fmt: skip
    sub.add_argument(
        '--tracker-place', metavar='X,Y,Z',
        help='beam origin of the tracker in the machine frame (m; default: in front, at -Y)',
    )  # fmt: skip
    sub.add_argument('--noise', help='noise.json of otf noise (default: as in machine.yaml)')
    sub.add_argument(
        '--dialect', choices=tuple(DIALECTS),
        help='write an NC program for this control; there is no generic one',
    )  # fmt: skip


def add_planning_verbs(verb: AddVerb) -> None:
    """Verbs that come before a measurement, or stand for one."""
    sub = verb('plan', run_plan)
    sub.add_argument('--machine', required=True, help='machine.yaml')
    add_out(sub, 'folder for path, forecast and program')
    sub.add_argument('--path', help='use this path: CSV x,y,z, plan.json or NC program')
    sub.add_argument(
        '--after', metavar='DIR',
        help='folder of a diagnosis: find the shortest path that distinguishes the causes that '
        'it could not distinguish',
    )  # fmt: skip
    _add_plan_options(sub)
    add_parameters(sub, PlannerConfig, 'feed')
    add_config(sub, 'plan')

    sub = verb('simulate', run_simulate)
    sub.add_argument('--machine', required=True, help='machine.yaml')
    add_out(sub, 'bag folder or .mcap file; the true errors are written with it')
    sub.add_argument('--tables', help='error_tables.json of the true errors (default: random)')
    sub.add_argument(
        '--path',
        help='CSV x,y,z or NC program; or plan.json of otf plan, with its feeds, dwells and '
        'tracker position (default: a planned path)',
    )
    sub.add_argument('--effects', help='effects.yaml: effects to add to the cell')
    add_parameters(sub, SimulationConfig, 'seed', 'rate', 'error_size', 'acceleration')
    add_parameters(sub, PlannerConfig, 'feed')
    add_config(sub, 'simulate')

# SPDX-License-Identifier: Apache-2.0
"""Public functions of ``otf_core``: read, plan, simulate, calibrate, diagnose, predict, write."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from otf_core.bags import bag
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import (
    CalibrationConfig,
    ForecastConfig,
    PlannerConfig,
    SimulationConfig,
)
from otf_core.effects import EVERY, AppliedEffect
from otf_core.effects.effects_yaml import effects_from_data, read_effects
from otf_core.errors import ConfigError, ShapeError
from otf_core.files.output_folder import MANIFEST, OutputFolder
from otf_core.inputs.recordings import ReadingOptions, path_of_machine, read_recording
from otf_core.live.stages import Progress
from otf_core.model.axis_path import AxisPath
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan, check_inside, plan_along
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import read_noise as noise_from_file
from otf_core.pieces.runs import Recording
from otf_core.prediction import predict as evaluation
from otf_core.prediction.calibration_document import (
    CalibrationDocument,
    load_tables,
)
from otf_core.prediction.predict import Prediction
from otf_core.reports import calibration
from otf_core.reports.calibration_page import calibration_summary

if TYPE_CHECKING:  # a calibration does not wait for what other verbs need
    from otf_core.diagnosis.result import Diagnosis
    from otf_core.planning.plan_report import PlanReport

# Public functions that read a run and write results.

Name = str | Path


def read_bag(
    source: Name,
    machine: Machine | Name,
    *,
    path: Name | None = None,
    topic: str | None = None,
    path_topic: str | None = None,
    columns: str | None = None,
    rate: float | None = None,
    time_format: str | None = None,
) -> Recording:
    """Read a recorded run.

    Parameters
    ----------
    source : str or Path
        A rosbag2 folder or an .mcap file with ``/tracker/point`` and ``/planner/path``; or a
        table of samples as text, with ``path``.
    machine : Machine, str or Path
        The machine that was driven, or its machine.yaml.
    path : str or Path, optional
        A plan.json, a CSV of corner points or an NC program, in place of what the recording holds.
    topic, path_topic : str, optional
        Other names of the two topics of a bag.
    columns : str, optional
        What stands in the columns of a text, e.g. ``time_s,x_mm,y_mm,z_mm``; as its head says if
        not given.
    rate : float, optional
        Hz; of samples in a text without times.
    time_format : str, optional
        Form of the times in a text, in words of ``strptime``; ISO 8601 or numbers if not given.

    Raises
    ------
    ConfigError
        If there is no recording, or machine.yaml is wrong.
    InputError
        If it is damaged, or holds no usable points and path.

    Examples
    --------
    >>> recording = otf_core.read_bag('bags/y-carries-the-table/bag', machine)
    >>> len(recording.samples), recording.samples.xyz.shape, recording.machine.name
    (38280, (38280, 3), 'wYbXZt')
    >>> round(recording.path.length, 3)
    41.005
    """
    return read_recording(
        [source],
        machine,
        ReadingOptions(path, topic, path_topic, columns, rate, time_format=time_format),
    )


def write_bag(recording: Recording, folder: Name, *, overwrite: bool = False) -> None:
    """Write a run as a rosbag2 folder, complete or not at all.

    Parameters
    ----------
    recording : Recording
        Its samples and its path; the machine is not part of a bag.
    overwrite : bool
        Replace a bag that is there; never anything else.

    Raises
    ------
    ConfigError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> otf_core.write_bag(recording, 'copy')
    >>> again = otf_core.read_bag('copy', machine)
    >>> bool((again.samples.stamp_ns == recording.samples.stamp_ns).all())
    True
    """
    content = bag.BagContent(recording.samples, recording.path)
    bag.write_bag(folder, content, overwrite=overwrite)


def write_calibration(
    result: CalibrationResult, folder: Name, *, overwrite: bool = False, report: bool = True
) -> list[Path]:
    """Write error_tables.json and its companions, all or nothing.

    Parameters
    ----------
    overwrite : bool
        Replace results that are there and unchanged; other files are never deleted.
    report : bool
        Write report.html.

    Raises
    ------
    ConfigError
        If the folder holds anything else or cannot be written.

    Examples
    --------
    >>> files = otf_core.write_calibration(result, 'results')
    >>> sorted(file.name for file in files)[:2]
    ['error_tables.csv', 'error_tables.json']
    """
    return _fill_folder(
        folder,
        overwrite,
        'calibrate',
        lambda place: calibration.write_calibration(result, place, report=report),
    )


def write_diagnosis(diagnosis: Diagnosis, folder: Name, *, overwrite: bool = False) -> list[Path]:
    """Write gap.json, report.html, and with causes what they do to the tables; all or nothing.

    Parameters
    ----------
    overwrite : bool
        As in `write_calibration`.

    Raises
    ------
    ConfigError
        If the folder holds anything else or cannot be written.

    Examples
    --------
    >>> files = otf_core.write_diagnosis(diagnosis, 'diagnosis')
    >>> [file.name for file in files]
    ['report.html', 'gap.json']
    """
    from otf_core.reports.diagnosis import write_diagnosis

    return _fill_folder(
        folder, overwrite, 'diagnose', lambda place: write_diagnosis(diagnosis, place)
    )


def write_plan(
    report: PlanReport, folder: Name, *, dialect: str | None = None, overwrite: bool = False
) -> list[Path]:
    """Write path, plan and forecast, and an NC program where a control is named.

    Parameters
    ----------
    dialect : str, optional
        Name of a dialect such as 'sinumerik' or 'linuxcnc'; there is no program for all.
    overwrite : bool
        As in `write_calibration`.

    Raises
    ------
    ConfigError
        If the dialect is unknown or cannot express the plan, or the folder cannot be written.

    Examples
    --------
    >>> files = otf_core.write_plan(report, 'plan', dialect='linuxcnc')
    >>> [file.name for file in files]
    ['otf_path_1.ngc', 'path.csv', 'report.html', 'plan.json']
    """
    from otf_core.planning.nc import DIALECTS
    from otf_core.reports.plan_files import write_report

    if dialect is not None and dialect not in DIALECTS:
        raise ConfigError(f'dialect: {dialect!r} is unknown; possible: {", ".join(DIALECTS)}')
    chosen = None if dialect is None else DIALECTS[dialect]
    return _fill_folder(
        folder, overwrite, 'plan', lambda place: write_report(report, place, chosen)
    )


def summary(of: CalibrationResult | Diagnosis | PlanReport) -> str:
    """Return a result as the text that the command line shows.

    Examples
    --------
    >>> print(otf_core.summary(diagnosis).splitlines()[0])
    verdict: none
    """
    if isinstance(of, CalibrationResult):
        return calibration_summary(of.to_dict())
    from otf_core.diagnosis.result import Diagnosis
    from otf_core.planning.plan_report import PlanReport
    from otf_core.reports.diagnosis import diagnosis_to_dict, format_diagnosis
    from otf_core.reports.plan_files import plan_summary, report_to_dict

    if isinstance(of, Diagnosis):
        return format_diagnosis(diagnosis_to_dict(of))
    if isinstance(of, PlanReport):
        return plan_summary(report_to_dict(of)).rstrip()
    raise ConfigError(f'summary: expected a result of otf_core, got {type(of).__name__}')


def _fill_folder(
    folder: Name, overwrite: bool, verb: str, write: Callable[[Path], list[Path]]
) -> list[Path]:
    """Fill a folder as a whole; return its files but the manifest."""
    with OutputFolder(folder, overwrite=overwrite).filled(verb) as partial:
        names = [file.relative_to(partial) for file in write(partial)]
    return [Path(folder) / name for name in names if name.name != MANIFEST]


# Public functions on recorded runs and on tables: calibrate, diagnose, predict.

Recordings = Recording | Iterable[Recording]


def calibrate(
    recordings: Recordings,
    *,
    method: str = 'otf',
    effects: str | Path | None = None,
    same_station: bool = False,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Error tables of a machine with their uncertainties, from one or several runs.

    Parameters
    ----------
    recordings : Recording or iterable of Recording
        Several: runs of one machine from other stations, at other feeds, with other target
        offsets; they are solved as one.
    method : {'otf', 'standstill'}
        On the fly, or from the stops at the corner points alone.
    effects : str or Path, optional
        Effects to take off: 'auto' for those that a diagnosis finds, or an effects.yaml.
    same_station : bool
        The tracker was not moved between the recordings; for runs of one target offset.
    progress : callable(stage, fraction), optional
        Called as work goes on; what it raises ends the work.

    Returns
    -------
    CalibrationResult
        Look at ``failed_gates`` and ``warnings`` before you use the tables.

    Raises
    ------
    InputError
        If samples and path do not belong together or determine nothing.
    ConfigError
        If the runs are of different machines, or an argument is wrong.

    Examples
    --------
    >>> result = otf_core.calibrate(recording)
    >>> result.failed_gates
    ()
    >>> result.fit.samples, result.fit.path_mae_after < 2e-6
    (38280, True)
    >>> table = result.tables.motions['EXX']  # linear positioning error of X
    >>> table.value.shape == table.u.shape == table.position.shape
    True
    """
    runs = _several(recordings)
    if effects is None:
        return calibrate_recordings(runs, config, progress, method, same_station=same_station)
    from otf_core.diagnosis.diagnose import calibrate_with_effects
    from otf_core.sim.twin import twin_recording

    return calibrate_with_effects(
        runs, str(effects), twin_recording, config, progress, method, same_station=same_station
    )


def diagnose(
    recordings: Recordings,
    *,
    exclude: Sequence[str] = (),
    own_causes: str | Path = '',
    same_station: bool = False,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Where and why runs depart from their simulation.

    Parameters
    ----------
    recordings : Recording or iterable of Recording
        Several: runs of one machine, diagnosed as one.
    exclude : sequence of str
        Effects that are not searched for.
    own_causes : str or Path, optional
        File of causes of your own to search for besides.
    same_station : bool
        As in `calibrate`.
    progress : callable(stage, fraction), optional
        Called as work goes on; what it raises ends the work.

    Raises
    ------
    InputError
        If samples and path do not belong together or determine nothing.
    ConfigError
        If the runs are of different machines, or ``exclude`` names what is not an effect.

    Examples
    --------
    >>> diagnosis = otf_core.diagnose(recording)
    >>> diagnosis.verdict, diagnosis.causes
    ('none', ())
    >>> diagnosis.gap.before_um < 0.1
    True
    """
    check_excluded(exclude)
    runs = _several(recordings)
    from otf_core.diagnosis.diagnose import diagnose
    from otf_core.effects.effects_yaml import read_own_causes
    from otf_core.sim.twin import twin_recording

    own = read_own_causes(own_causes, runs[0].machine) if own_causes else ()
    return diagnose(
        runs, twin_recording, exclude, config, progress, own=own, same_station=same_station
    )


def check_excluded(exclude: Sequence[str]) -> None:
    """Refuse what is not the name of an effect, with a ConfigError."""
    unknown = [name for name in exclude if name not in EVERY]
    if unknown:
        raise ConfigError(f'exclude: {unknown[0]} is not an effect; known: {", ".join(EVERY)}')


def predict(
    tables: CalibrationResult | CalibrationDocument | ErrorTables | str | Path,
    points: ArrayLike,
    *,
    target_offset: ArrayLike | None = None,
) -> Prediction:
    """Volumetric errors at points: actual minus nominal, with standard uncertainties.

    Parameters
    ----------
    tables : CalibrationResult, CalibrationDocument, ErrorTables, str or Path
        A result, or an error_tables.json, read or not. Tables alone hold no covariance: their
        nodes are taken as independent then.
    points : array_like, shape (n, m), m and rad
        Programmed axis positions x, y, z, then those of the rotary axes; zero along what is no
        axis.
    target_offset : array_like, shape (3,), m, optional
        Predict for this one, e.g. a longer tool; as measured if not given.

    Raises
    ------
    ConfigError
        If the tables cannot be read, or points or offset are not of such a machine.
    ShapeError
        If points are not rows of these.

    Examples
    --------
    >>> there = otf_core.predict(result, [[0.1, 0.1, -0.2], [-0.15, 0.0, -0.1]])
    >>> there.error.shape, there.inside.tolist()
    ((2, 3), [True, True])
    >>> bool((there.u_run < 3e-6).all() and (there.u > there.u_run).all())
    True
    """
    if isinstance(tables, CalibrationResult):
        source = tables.document
    elif isinstance(tables, ErrorTables):
        source = CalibrationDocument.of_tables(tables)
    else:
        source = tables if isinstance(tables, CalibrationDocument) else load_tables(tables)
    q, names = np.asarray(points, dtype=float), source.tables.machine.point_names
    if q.ndim != 2 or q.shape[1] != len(names):
        raise ShapeError(
            f'points: expected shape (n, {len(names)}), got {q.shape}: a column for each of '
            f'{", ".join(names)}'
        )
    if not np.all(np.isfinite(q)):
        first = int(np.flatnonzero(~np.isfinite(q).all(axis=1))[0])
        raise ConfigError(f'points: point {first + 1} is not finite')
    offset = None if target_offset is None else np.asarray(target_offset, dtype=float)
    return evaluation.predict(source, q, offset)


def _several(recordings: Recordings) -> list[Recording]:
    if isinstance(recordings, Recording):
        return [recordings]
    runs = list(recordings) if isinstance(recordings, Iterable) else [recordings]
    wrong = [run for run in runs if not isinstance(run, Recording)]
    if wrong:
        raise ConfigError(f'recordings: expected Recording, got {type(wrong[0]).__name__}')
    if not runs:
        raise ConfigError('recordings: none given')
    return runs


# Public functions that come before a measurement, or stand for one: plan, simulate.

Effects = Mapping[str, Mapping[str, float]] | str | Path


@dataclass(frozen=True)
class Simulation:
    """A simulated run and the truth behind it.

    Attributes
    ----------
    recording : Recording
        As `read_bag` returns a real one.
    truth : ErrorTables
        The errors of the simulated machine.
    T_machine_tracker : RigidTransform
        The true pose of the tracker: takes tracker to machine coordinates.
    """

    recording: Recording
    truth: ErrorTables
    T_machine_tracker: RigidTransform


def plan(
    machine: Machine,
    path: Plan | NominalPath | ArrayLike | None = None,
    *,
    time_budget: float | None = None,
    wanted_uncertainty: float | None = None,
    tracker_place: ArrayLike | None = None,
    noise: str | Path | None = None,
    config: PlannerConfig | None = None,
    forecast: ForecastConfig | None = None,
) -> PlanReport:
    """Path for a machine, and what it will show before anything moves.

    Parameters
    ----------
    path : Plan, NominalPath or array_like, shape (n, 3), m, optional
        Judge this path instead of making one.
    time_budget : float, optional
        s; choose lines, passes and feeds so that the grid is known best after this time.
    wanted_uncertainty : float, optional
        m; the same for this mean grid uncertainty in a short time.
    tracker_place : array_like, shape (3,), m, optional
        Beam origin in the machine frame; in front of the volume if not given.
    noise : str or Path, optional
        noise.json of ``otf noise``; as specified in machine.yaml if not given.

    Returns
    -------
    PlanReport
        ``plan`` is the plan, ``forecast`` what it will show.

    Raises
    ------
    ConfigError
        If the wishes contradict each other or cannot be met.
    InputError
        If the path leaves the axis ranges.

    Examples
    --------
    >>> few = otf_core.PlannerConfig(passes=1, levels=2)
    >>> report = otf_core.plan(machine, config=few)
    >>> len(report.plan.path.points), round(report.forecast.duration)
    (72, 111)
    >>> 0 < report.forecast.mean_grid_u < 2e-6
    True
    """
    from otf_core.planning.plan_report import PlanRequest, make_plan

    config = config or PlannerConfig()
    place = None if tracker_place is None else np.asarray(tracker_place, dtype=float)
    if place is not None and (place.shape != (3,) or not np.all(np.isfinite(place))):
        raise ConfigError(f'tracker_place: expected x, y, z in m, got {tracker_place!r}')
    request = PlanRequest(
        given=None if path is None else _plan_along(path, machine, config),
        time_budget=time_budget,
        wanted_uncertainty=wanted_uncertainty,
        tracker_place=None if place is None else (*place.tolist(),),
        noise=None if noise is None else noise_from_file(noise),
    )
    return make_plan(machine, request, config, forecast or ForecastConfig())


def simulate(
    machine: Machine,
    plan: Plan | PlanReport | None = None,
    *,
    seed: int | None = None,
    tables: ErrorTables | str | Path | None = None,
    effects: Effects | None = None,
    tracker_place: ArrayLike | None = None,
    config: SimulationConfig | None = None,
) -> Simulation:
    """Simulate a run: exact kinematics, a drive, a tracker with noise and a clock of its own.

    Parameters
    ----------
    plan : Plan or PlanReport, optional
        What is driven; of a report also the place of the tracker. The default path if not given.
    seed : int, optional
        Seed of all random draws; that of ``config`` if not given.
    tables : ErrorTables, str or Path, optional
        Errors of the machine, or an error_tables.json; drawn if not given.
    effects : mapping, str or Path, optional
        What else is wrong: names of effects to their parameters in SI units, or an effects.yaml.
    tracker_place : array_like, shape (3,), m, optional
        Beam origin in the frame of what the tracker stands on; drawn if no report says where.

    Raises
    ------
    ConfigError
        If an effect or a file is wrong, the tables are of another chain, or the run is too long
        to be simulated.
    InputError
        If the plan leaves the axis ranges.

    Examples
    --------
    >>> slow = otf_core.SimulationConfig(rate=100.0)
    >>> lost = {'backlash': {'B_X': 5e-6}}  # 5 um
    >>> run = otf_core.simulate(machine, report, seed=3, effects=lost, config=slow)
    >>> len(run.recording.samples) > 10_000
    True
    >>> bool(abs(run.T_machine_tracker.translation - report.setup.place).max() < 1e-12)
    True
    """
    from otf_core.planning.forecast import Setup
    from otf_core.planning.part_choice import planned
    from otf_core.planning.plan_report import PlanReport
    from otf_core.sim.cell import simulate

    config = config or SimulationConfig()
    if seed is not None:
        config = replace(config, seed=seed)
    place = None if tracker_place is None else np.asarray(tracker_place, dtype=float)
    if isinstance(plan, PlanReport):
        place = plan.setup.place if place is None else place
        plan = plan.plan
    driven = planned(Setup.of(machine), PlannerConfig()) if plan is None else plan
    check_inside(driven, machine)
    truth = tables if isinstance(tables, ErrorTables) or tables is None else None
    if isinstance(tables, (str, Path)):
        truth = load_tables(tables).tables
    if truth is not None:
        truth = truth.on(machine)
    run = simulate(machine, driven, config, truth, _effects(effects, machine), place)
    path = path_of_machine(() if run.path else run.parts, run.path, machine)
    name = f'simulation of seed {config.seed}'
    return Simulation(
        Recording(run.samples, path, machine, name),
        run.truth,
        run.pose,
    )


def _plan_along(
    path: Plan | NominalPath | ArrayLike, machine: Machine, config: PlannerConfig
) -> Plan:
    if not isinstance(path, Plan):
        points = path.points if isinstance(path, NominalPath) else np.asarray(path, float)
        path = plan_along(machine, [AxisPath.of_points(machine, points)], config)
    check_inside(path, machine)
    return path


def _effects(effects: Effects | None, machine: Machine) -> Sequence[AppliedEffect]:
    if effects is None:
        return ()
    if isinstance(effects, (str, Path)):
        return read_effects(effects, machine)
    data = [{'effect': name, 'parameters': dict(values)} for name, values in effects.items()]
    return effects_from_data(data, 'effects', machine)

# SPDX-License-Identifier: Apache-2.0
"""Public functions of ``otf_core``: read, plan, simulate, calibrate, diagnose, predict, write."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from otf_core.arrays import Array
from otf_core.bags import bag
from otf_core.calibration.calibrate import calibrate_pairs, calibrate_recordings
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import (
    POINTS,
    CalibrationConfig,
    ForecastConfig,
    PlannerConfig,
    SimulationConfig,
)
from otf_core.documents import ResultDocument
from otf_core.effects import EVERY, AppliedEffect
from otf_core.effects.effects_yaml import effects_from_data, read_effects
from otf_core.errors import ConfigError, OtfError, ShapeError
from otf_core.files.output_folder import MANIFEST, OutputFolder
from otf_core.inputs.recordings import (
    ReadingOptions,
    open_reading,
    path_of_machine,
    read_recording,
)
from otf_core.live.stages import Progress, silent
from otf_core.model.axis_path import AxisPath
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine, load_machine
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan, check_inside, plan_along
from otf_core.model.provenance import STANDARD, origin_of, provenance
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import read_noise as noise_from_file
from otf_core.pieces.point_pairs import PointPairs
from otf_core.pieces.runs import Recording
from otf_core.prediction import predict as evaluation
from otf_core.prediction.calibration_document import (
    CalibrationDocument,
    load_tables,
)
from otf_core.prediction.predict import Prediction
from otf_core.reports import calibration
from otf_core.reports.pages import summary_of

if TYPE_CHECKING:  # a calibration does not wait for what other verbs need
    from otf_core.comparison.document import ComparisonDocument
    from otf_core.diagnosis.result import Diagnosis
    from otf_core.noise.report import NoiseReport
    from otf_core.planning.plan_report import PlanReport
    from otf_core.sim.cell import SimulatedRun

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
    from otf_core.reports import plan_files

    if dialect is not None and dialect not in DIALECTS:
        raise ConfigError(f'dialect: {dialect!r} is unknown; possible: {", ".join(DIALECTS)}')
    chosen = None if dialect is None else DIALECTS[dialect]
    return _fill_folder(
        folder, overwrite, 'plan', lambda place: plan_files.write_plan(report, place, chosen)
    )


def summary(of: CalibrationResult | Diagnosis | PlanReport | ResultDocument) -> str:
    """Return a result, or its document, as the text that the command line shows.

    Examples
    --------
    >>> print(otf_core.summary(diagnosis).splitlines()[0])
    verdict: none
    """
    document = getattr(of, 'document', of)
    if not isinstance(document, ResultDocument):
        raise ConfigError(f'summary: expected a result of otf_core, got {type(of).__name__}')
    return summary_of(document)


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
    recordings: Recordings | Sequence[PointPairs],
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
        offsets; they are solved as one. Or the runs of ``read_point_pairs``.
    method : {'otf', 'standstill', 'points'}
        On the fly, from the stops at the corner points alone, or from pairs of points.
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
    if method == POINTS:
        if effects is not None:
            raise ConfigError('effects: pairs of points hold neither feed nor direction of travel')
        return calibrate_pairs(_pairs_of(recordings), config, progress)
    runs = _several(recordings)
    if effects is None:
        return calibrate_recordings(runs, config, progress, method, same_station=same_station)
    from otf_core.diagnosis.diagnose import calibrate_with_effects

    return calibrate_with_effects(
        runs, str(effects), config, progress, method, same_station=same_station
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

    own = read_own_causes(own_causes, runs[0].machine) if own_causes else ()
    return diagnose(runs, exclude, config, progress, own=own, same_station=same_station)


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


def noise(source: Name, standstill_speed: float, options: ReadingOptions) -> NoiseReport:
    """Noise of the tracker in the standstills of a recording, as ``otf noise`` states it."""
    from otf_core.noise.report import noise_report

    reading = open_reading(source, options)
    samples = bag.points_of(reading, str(source))
    origin = replace(origin_of(Path(source).name, samples), left_out=tuple(reading.left_out))
    try:
        parts = max(len(reading.axis_paths), 1)
        return noise_report(samples, standstill_speed, parts, origin)
    except OtfError as error:
        raise type(error)(f'{source}: {error}') from None


def compare(
    a: Name,
    b: Name,
    machine: Name | None = None,
    points: Name | None = None,
    sign: str | None = None,
) -> ComparisonDocument:
    """Two error tables or direct measurements, as ``otf compare`` states them.

    Parameters
    ----------
    machine : str or Path, optional
        machine.yaml, of what does not hold its machine; that of the other if not given.
    points : str or Path, optional
        File of the points at which error vectors are compared; a grid if not given.
    sign : {'error', 'correction'}, optional
        What values of other systems are, where their files do not state it.
    """
    from otf_core.comparison import compare as sources
    from otf_core.comparison.document import document_of
    from otf_core.inputs.path_file import read_target_points

    described = load_machine(machine) if machine else None
    (first, second), remarks = sources.load_sources((a, b), described, sign)
    at, own = None, first.tables.machine
    if points:
        at = own.axis_positions(read_target_points(points, own.point_names)[0])
    about = provenance(
        'compare',
        machines=[described] if described else [],
        files={'a': a, 'b': b, 'points': points},
        coverage=f'{STANDARD}; normalised errors with U = 2 u (k = 2)',
    )
    document = document_of(sources.compare(first, second, at), about)
    return replace(document, remarks=(*document.remarks, *remarks))


def _pairs_of(recordings: object) -> list[PointPairs]:
    """Runs of pairs; ConfigError if they are anything else."""
    given = list(recordings) if isinstance(recordings, Iterable) else [recordings]
    runs = [run for run in given if isinstance(run, PointPairs)]
    if not runs or len(runs) < len(given):
        raise ConfigError(f'method {POINTS}: expected the runs of read_point_pairs')
    return runs


def _several(recordings: object) -> list[Recording]:
    given = list(recordings) if isinstance(recordings, Iterable) else [recordings]
    runs = [run for run in given if isinstance(run, Recording)]
    if len(runs) < len(given):
        wrong = next(run for run in given if not isinstance(run, Recording))
        raise ConfigError(f'recordings: expected Recording, got {type(wrong).__name__}')
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
    run : SimulatedRun
        All that was simulated.
    effects : sequence of AppliedEffect
        What was wrong besides.
    """

    recording: Recording
    truth: ErrorTables
    T_machine_tracker: RigidTransform
    run: SimulatedRun
    effects: Sequence[AppliedEffect]


def plan(
    machine: Machine,
    path: Plan | NominalPath | ArrayLike | None = None,
    *,
    time_budget: float | None = None,
    wanted_uncertainty: float | None = None,
    tracker_place: ArrayLike | None = None,
    noise: str | Path | None = None,
    after: str | Path | None = None,
    config: PlannerConfig | None = None,
    forecast: ForecastConfig | None = None,
    progress: Progress = silent,
    files: Mapping[str, str | Path | None] | None = None,
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
    after : str or Path, optional
        Folder of a diagnosis: the shortest path that answers what it left open.
    progress : callable(stage, fraction), optional
        Called as work goes on.
    files : mapping of str to path, optional
        What was read, for the provenance.

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
    from otf_core.planning.follow_up import measured_runs, open_questions
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
        questions=() if after is None else tuple(open_questions(after, machine)),
        before=() if after is None or place is not None else tuple(measured_runs(after)),
        files=files or {},
    )
    return make_plan(machine, request, config, forecast or ForecastConfig(), progress)


def simulate(
    machine: Machine,
    plan: Plan | PlanReport | None = None,
    *,
    seed: int | None = None,
    tables: ErrorTables | str | Path | None = None,
    effects: Effects | None = None,
    tracker_place: ArrayLike | None = None,
    config: SimulationConfig | None = None,
    planning: PlannerConfig | None = None,
) -> Simulation:
    """Simulate a run: exact kinematics, a drive, a tracker with noise and a clock of its own.

    Parameters
    ----------
    plan : Plan or PlanReport, optional
        What is driven; of a report also the place of the tracker. The path that ``planning``
        makes if not given.
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
    planning = planning or PlannerConfig()
    driven = planned(Setup.of(machine), planning) if plan is None else plan
    check_inside(driven, machine)
    truth = tables if isinstance(tables, ErrorTables) or tables is None else None
    if isinstance(tables, (str, Path)):
        truth = load_tables(tables).tables
    if truth is not None:
        truth = truth.on(machine)
    applied = _effects(effects, machine)
    run = simulate(machine, driven, config, truth, applied, place)
    path = path_of_machine(() if run.path else run.parts, run.path, machine)
    name = f'simulation of seed {config.seed}'
    return Simulation(
        Recording(run.samples, path, machine, name),
        run.truth,
        run.pose,
        run,
        applied,
    )


DWELLS = ('corner_dwell', 'end_dwell')
"""Parameters of the planner that a plan leaves open."""


def read_plan(
    name: Name, machine: Machine, config: PlannerConfig, stated: Collection[str] = ()
) -> tuple[Plan, Array | None]:
    """Read what is to be driven: a plan.json, corner points or an NC program.

    Parameters
    ----------
    stated : collection of str
        Parameters of ``config`` that were given: a plan.json takes dwells alone.

    Returns
    -------
    plan : Plan
    place : ndarray, shape (3,), m, or None
        Of the tracker, as a plan.json assumes it.

    Raises
    ------
    ConfigError
        Names the file and what is wrong with it.
    """
    from otf_core.inputs import path_file

    place = None
    try:
        if path_file.looks_like_json(name):
            file, plan = path_file.read_plan(name)
            place, link = file.assumed.tracker_place, file.assumed.tracker_link
            if link != machine.tracker.link:
                raise ConfigError(
                    f'{name}: plans a tracker on link {link}, machine.yaml states '
                    f'{machine.tracker.link}: plan again with this machine.yaml'
                )
            plan = _with_dwells(plan.of(machine), name, config, stated)
        elif machine.rotary_names or path_file.holds_axis_positions(name):
            paths = path_file.read_axis_paths(name, machine.axis_names)
            plan = plan_along(machine, paths, config)
        else:
            corners, words = path_file.read_path(name)
            if words:
                logging.getLogger(__name__).info(words)
            plan = plan_along(machine, [AxisPath.of_points(machine, corners)], config)
        check_inside(plan, machine)
    except ConfigError as error:
        if 'header x,y,z' not in str(error):
            raise
        raise ConfigError(f'{error}; or give the plan.json of otf plan') from None
    except OtfError as error:
        raise ConfigError(f'{name}: {error}') from None
    return plan, place


def _with_dwells(plan: Plan, name: Name, config: PlannerConfig, stated: Collection[str]) -> Plan:
    """Take the dwells that were given; refuse parameters that the plan decides."""
    decided = [key for key in stated if key not in DWELLS]
    if decided:
        raise ConfigError(
            f'{decided[0]}: {name} is a plan, which sets this; give its path.csv to drive the '
            f'same path with other settings'
        )
    parts = []
    for part in plan.parts:
        dwell = part.dwell.copy()
        if 'corner_dwell' in stated and not part.stops:
            dwell[1:-1][dwell[1:-1] > 0.0] = config.corner_dwell
        if 'end_dwell' in stated:
            dwell[[0, -1]] = config.end_dwell
        parts.append(replace(part, dwell=dwell))
    return replace(plan, parts=tuple(parts))


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

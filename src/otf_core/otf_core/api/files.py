# SPDX-License-Identifier: Apache-2.0
"""Public functions that read a run and write results."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from otf_core.bags import bag
from otf_core.calibration.result import CalibrationResult
from otf_core.diagnosis.result import Diagnosis
from otf_core.errors import ConfigError
from otf_core.files.manifest import MANIFEST
from otf_core.files.output import OutputFolder
from otf_core.inputs.recordings import Given, read_recording
from otf_core.model.machine import Machine
from otf_core.pieces.runs import Recording
from otf_core.planning.nc import DIALECTS
from otf_core.planning.plan_report import PlanReport
from otf_core.reports import calibration, plan_files
from otf_core.reports import diagnosis as reports

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
    publisher: int | None = None,
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
    publisher : int, optional
        Whose samples, from 1, where several trackers published on one topic.

    Returns
    -------
    Recording

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
        [source], machine, Given(path, topic, path_topic, columns, rate, publisher=publisher)
    )


def write_bag(recording: Recording, folder: Name, *, overwrite: bool = False) -> None:
    """Write a run as a rosbag2 folder, complete or not at all.

    Parameters
    ----------
    recording : Recording
        Its samples and its path; the machine is not part of a bag.
    folder : str or Path
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
    parts = recording.axis_paths
    content = bag.BagContent(
        recording.samples, None if parts else recording.path, axis_paths=parts
    )
    bag.write_bag(folder, content, overwrite=overwrite)


def write_calibration(
    result: CalibrationResult, folder: Name, *, overwrite: bool = False, report: bool = True
) -> list[Path]:
    """Write error_tables.json and its companions, all or nothing.

    Parameters
    ----------
    result : CalibrationResult
    folder : str or Path
    overwrite : bool
        Replace results that are there and unchanged; other files are never deleted.
    report : bool
        Write report.html.

    Returns
    -------
    list of Path

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
    return _written(
        folder,
        overwrite,
        'calibrate',
        lambda place: calibration.write_calibration(result, place, report=report),
    )


def write_diagnosis(diagnosis: Diagnosis, folder: Name, *, overwrite: bool = False) -> list[Path]:
    """Write gap.json, report.html, and with causes what they do to the tables; all or nothing.

    Parameters
    ----------
    diagnosis : Diagnosis
    folder : str or Path
    overwrite : bool
        As in `write_calibration`.

    Returns
    -------
    list of Path

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
    return _written(
        folder, overwrite, 'diagnose', lambda place: reports.write_diagnosis(diagnosis, place)
    )


def write_plan(
    report: PlanReport, folder: Name, *, dialect: str | None = None, overwrite: bool = False
) -> list[Path]:
    """Write path, plan and forecast, and an NC program where a control is named.

    Parameters
    ----------
    report : PlanReport
    folder : str or Path
    dialect : str, optional
        Name of a dialect such as 'sinumerik' or 'linuxcnc'; there is no program for all.
    overwrite : bool
        As in `write_calibration`.

    Returns
    -------
    list of Path

    Raises
    ------
    ConfigError
        If the dialect is unknown or cannot express the plan, or the folder cannot be written.

    Examples
    --------
    >>> files = otf_core.write_plan(report, 'plan', dialect='linuxcnc')
    >>> [file.name for file in files]
    ['otf_path.ngc', 'path.csv', 'forecast.txt', 'plan.svg', 'report.html', 'plan.json']
    """
    if dialect is not None and dialect not in DIALECTS:
        raise ConfigError(f'dialect: {dialect!r} is unknown; possible: {", ".join(DIALECTS)}')
    chosen = None if dialect is None else DIALECTS[dialect]
    return _written(
        folder, overwrite, 'plan', lambda place: plan_files.write_report(report, place, chosen)
    )


def summary(of: CalibrationResult | Diagnosis | PlanReport) -> str:
    """Return a result as the text that the command line shows.

    Parameters
    ----------
    of : CalibrationResult, Diagnosis or PlanReport

    Returns
    -------
    str

    Examples
    --------
    >>> print(otf_core.summary(diagnosis).splitlines()[0])
    verdict: none
    """
    if isinstance(of, CalibrationResult):
        return calibration.format_result(of)
    if isinstance(of, Diagnosis):
        return reports.format_diagnosis(of)
    if isinstance(of, PlanReport):
        return plan_files.format_report(of)
    raise ConfigError(f'summary: expected a result of otf_core, got {type(of).__name__}')


def _written(
    folder: Name, overwrite: bool, verb: str, write: Callable[[Path], list[Path]]
) -> list[Path]:
    """Fill a folder as a whole; return its files but the manifest."""
    with OutputFolder(folder, overwrite=overwrite).filled(verb) as partial:
        names = [file.relative_to(partial) for file in write(partial)]
    return [Path(folder) / name for name in names if name.name != MANIFEST]

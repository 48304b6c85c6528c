# SPDX-License-Identifier: Apache-2.0
"""From recordings to error tables: follow the path, reduce, examine, solve, state uncertainty.

Every recording of every chain takes this way (``solve_recordings``):

1. ``runs.follow`` finds the pose of the tracker, the places of the reflectors and the leg of every
   sample, part by part. Where three linear axes carry one target past the tracker, legs are lines
   in its frame; else they are curves of places that are improved together with the pose.
2. ``runs.reduce_recording`` averages samples over pieces of legs, or over stops, to ``Run``.
3. ``examine`` looks for contradictions, and repairs offsets and steps of runs on lines.
4. ``model_choice.solve_with_reversal`` chooses functions and reversal, and solves. Samples on
   curves are reduced once more at the places and errors that the first solution found.
5. ``assembly.assemble`` states tables, budget and verdicts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from otf_core.arrays import Array
from otf_core.calibration.assembly import assemble
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import METHODS, OTF, CalibrationConfig
from otf_core.contradictions.examine import check_left_out, examine
from otf_core.contradictions.part_steps import LEAST, find_steps
from otf_core.contradictions.recording_checks import check_recordings
from otf_core.contradictions.table_checks import check_table_pitch
from otf_core.errors import ConfigError, InputError
from otf_core.live.stages import Progress, silent
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.pieces.finding import (
    GATE,
    WARNING,
    Finding,
)
from otf_core.pieces.point_pairs import PointPairs, prepare_pairs
from otf_core.pieces.runs import (
    Recording,
    Run,
    located_tables,
    prepare_runs,
    reduce_run_again,
)
from otf_core.solving.joint import UnsettledError
from otf_core.solving.model_choice import ReversalSolution, solve_with_reversal
from otf_core.threads import limit_to_one_thread


def calibrate(
    samples: Samples,
    path: NominalPath,
    machine: Machine,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate one run on the fly; see ``calibrate_recordings``."""
    return calibrate_recordings([Recording(samples, path, machine)], config, progress)


@limit_to_one_thread
def calibrate_recordings(
    recordings: Sequence[Recording],
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
    method: str = OTF,
    *,
    same_station: bool = False,
) -> CalibrationResult:
    """Calibrate a machine of any chain, on the fly or from its stops.

    On the fly, only deviations perpendicular to the path are used.

    Parameters
    ----------
    recordings : sequence of Recording
        Runs of one machine; no time relation between samples and path is needed. Other tracker
        places, feeds and target offsets add to what can be seen.
    progress : callable(stage, fraction), optional
        Called as work goes on, stage 'aligning' or 'solving'; what it raises ends the work.
    method : str
        'otf', or 'standstill': only the stops at the corners.
    same_station : bool
        The tracker was not moved between the recordings.

    Raises
    ------
    InputError
        If samples and path do not belong together or determine nothing.
    ConfigError
        If the runs are of different machines, or the method is unknown.

    References
    ----------
    Sanders et al., J. Manuf. Mater. Process. 2023, 7, 60, section 1.2.
    """
    config, progress = config or CalibrationConfig(), progress or silent
    solved = solve_recordings(recordings, config, progress, method, same_station=same_station)
    return assemble(solved.solution, config, solved.findings)


@limit_to_one_thread
def calibrate_pairs(
    runs: Sequence[PointPairs],
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate a machine of any chain from pairs of nominal and measured positions.

    Parameters
    ----------
    runs : sequence of PointPairs
        Of one machine; each has a rigid motion of its own between both frames.
    config, progress
        As of ``calibrate_recordings``.

    Raises
    ------
    InputError
        If the pairs determine nothing.
    """
    progress = progress or silent
    config = replace(config or CalibrationConfig(), reversal='none')
    prepared, nodes = prepare_pairs(runs)
    progress('solving', 0.0)
    solved = solve_with_reversal(prepared, nodes, config, progress)
    remarks = [Finding('recording', WARNING, text) for run in runs for text in run.remarks]
    left_out = [
        f for pair in zip(prepared, solved.runs, strict=True) for f in check_left_out(*pair)
    ]
    return assemble(solved, config, (*remarks, *left_out))


@dataclass(frozen=True)
class ExaminedRecordings:
    """Recordings that are examined: solutions, corrections and a diagnosis start here.

    Attributes
    ----------
    runs : list of Run
        Repaired where ``contradictions`` could repair them, with all their pieces.
    nodes : mapping of axis to ndarray, m and rad
        Table nodes.
    findings : tuple of Finding
        Contradictions, and what was repaired, of all runs.
    """

    runs: list[Run]
    nodes: dict[str, Array]
    findings: tuple[Finding, ...]

    @property
    def source(self) -> list[int]:
        """Recording that each run is of, or a part of where it was cut."""
        return [int(k) for k in np.cumsum([run.late == 0.0 for run in self.runs]) - 1]


@dataclass(frozen=True)
class SolvedRecordings(ExaminedRecordings):
    """Recordings that are examined and solved."""

    solution: ReversalSolution[Run]


@limit_to_one_thread
def solve_recordings(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress = silent,
    method: str = OTF,
    *,
    same_station: bool = False,
    repair: bool = True,
) -> SolvedRecordings:
    """Follow, reduce to pieces, examine and solve.

    Parameters
    ----------
    recordings, config, progress, method, same_station
        As of ``calibrate_recordings``.
    repair : bool
        Repair what can be repaired, see ``contradictions.examine``.
    """
    if method not in METHODS:
        raise ConfigError(f'method: {method!r} is unknown; possible: {", ".join(METHODS)}')
    progress('aligning', 0.0)
    check_recordings(recordings)
    pitch = check_table_pitch(recordings[0].machine, config.piece_length)
    runs, nodes = prepare_runs(recordings, config, method, progress, same_station=same_station)

    progress('solving', 0.0)
    remarks = [Finding('recording', WARNING, text) for r in recordings for text in r.remarks]
    if pitch:
        remarks.append(Finding('table_pitch', WARNING, pitch.removeprefix('table_pitch: ')))
    remarks += [Finding('path', WARNING, text) for r in runs for text in r.alignment.remarks]
    runs, contradictions = examine(runs, nodes, config, repair=repair)
    located = located_tables(runs[0].machine, nodes, runs[0].alignment.location)
    reduce_again = partial(reduce_run_again, nodes=nodes, config=config, method=method)
    try:
        solution = solve_with_reversal(runs, nodes, config, progress, located, reduce_again)
    except UnsettledError as error:
        moved = find_steps(error.joint, LEAST)
        raise InputError(moved[0] if moved else str(error)) from None
    # not before: places that are 0.1 mm off along the path look like a step
    steps = [Finding('steps', GATE, words) for words in find_steps(solution.joint)]
    runs = solution.whole
    left_out = [f for pair in zip(runs, solution.runs, strict=True) for f in check_left_out(*pair)]
    return SolvedRecordings(runs, nodes, (*remarks, *contradictions, *steps, *left_out), solution)

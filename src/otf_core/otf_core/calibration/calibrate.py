# SPDX-License-Identifier: Apache-2.0
"""From recordings to error tables: align, reduce, examine, solve, state uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.calibration import assembly
from otf_core.calibration.assembly import Solved
from otf_core.calibration.axis_calibration import calibrate_axes
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import OTF, CalibrationConfig
from otf_core.contradictions.examine import check_left_out, examine
from otf_core.contradictions.recording_checks import check_recordings
from otf_core.contradictions.table_checks import check_table_pitch
from otf_core.effects.stated_effect import RemovedEffects
from otf_core.live.stages import Progress, silent
from otf_core.model.machine import TOOL, Machine
from otf_core.model.nodes import SAME_PLACE
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.pieces.finding import (
    WARNING,
    Finding,
)
from otf_core.pieces.methods import PREPARATIONS, Preparation
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.prediction.calibration_document import DrivenPart
from otf_core.solving.joint import SolvedRun
from otf_core.solving.model_choice import ReversalSolution, solve_with_reversal
from otf_core.threads import one_thread


def calibrate(
    samples: Samples,
    path: NominalPath,
    machine: Machine,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate one run on the fly; see ``calibrate_runs``."""
    return calibrate_runs([Recording(samples, path, machine)], config, progress)


def calibrate_runs(
    recordings: Sequence[Recording],
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
    prepare: Preparation = prepare_runs,
) -> CalibrationResult:
    """Calibrate on the fly: only deviations perpendicular to the path are used.

    Parameters
    ----------
    recordings : sequence of Recording
        Runs of one machine; no time relation between samples and path is needed. Other tracker
        places, feeds and target offsets add to what can be seen.
    progress : callable(stage, fraction), optional
        Called as work goes on, stage 'aligning' or 'solving'; what it raises ends the work.
    prepare : callable, optional
        One of ``methods.PREPARATIONS``.

    Raises
    ------
    InputError
        If samples and path do not belong together or determine nothing.

    References
    ----------
    Sanders et al., J. Manuf. Mater. Process. 2023, 7, 60, section 1.2.
    """
    config, progress = config or CalibrationConfig(), progress or silent
    with one_thread():
        solved = solve_recordings(recordings, config, progress, prepare)
        return assemble(solved.solution, config, solved.findings)


def calibrate_recordings(
    recordings: Sequence[Recording],
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
    method: str = OTF,
    *,
    same_station: bool = False,
) -> CalibrationResult:
    """Calibrate a machine of any chain, on the fly or from its stops.

    Parameters
    ----------
    recordings, config, progress
        As of ``calibrate_runs``.
    method : str
        'otf', or 'standstill': only the stops at the corners.
    same_station : bool
        The tracker was not moved between the recordings.

    Raises
    ------
    InputError
        If samples and path do not belong together or determine nothing.
    """
    config, progress = config or CalibrationConfig(), progress or silent
    if recordings[0].axis_paths:
        return calibrate_axes(recordings, config, progress, method, same_station=same_station)
    return calibrate_runs(recordings, config, progress, PREPARATIONS[method])


@dataclass(frozen=True)
class ExaminedRecordings:
    """Recordings that are examined: solutions, corrections and a diagnosis start here.

    Attributes
    ----------
    runs : list of Run
        Repaired where ``contradictions`` could repair them, with all their pieces.
    nodes : mapping of axis to ndarray, m
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


def solve_recordings(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress = silent,
    prepare: Preparation = prepare_runs,
    *,
    repair: bool = True,
) -> SolvedRecordings:
    """Align, reduce to pieces, examine and solve.

    Parameters
    ----------
    recordings, config, progress, prepare
        As of ``calibrate_runs``.
    repair : bool
        Repair what can be repaired, see ``contradictions.examine``.
    """
    progress('aligning', 0.0)
    check_recordings(recordings)
    pitch = check_table_pitch(recordings[0].machine, config.piece_length)
    runs, nodes = prepare(recordings, config)

    progress('solving', 0.0)
    runs, contradictions = examine(runs, nodes, config, repair=repair)

    solution = solve_with_reversal(runs, nodes, config, progress)

    left_out = [f for pair in zip(runs, solution.runs, strict=True) for f in check_left_out(*pair)]
    repairs = [Finding('recording', WARNING, text) for r in recordings for text in r.remarks]
    if pitch:
        repairs.append(Finding('table_pitch', WARNING, pitch.removeprefix('table_pitch: ')))
    return SolvedRecordings(runs, nodes, (*repairs, *contradictions, *left_out), solution)


def assemble(
    solved: ReversalSolution[Run],
    config: CalibrationConfig,
    findings: Sequence[Finding] = (),
    removed: RemovedEffects | None = None,
) -> CalibrationResult:
    """Work out the result of a solution, see ``assembly.assemble``."""
    runs, joint = solved.runs, solved.joint
    return assembly.assemble(
        Solved(
            recordings=[r.recording for r in runs],
            parts=[[_part_of(r, s)] for r, s in zip(runs, joint.runs, strict=True)],
            coverage=[r.alignment.coverage for r in runs],
            joint=joint,
            choice=solved.choice,
            rest=config.standstill_speed,
        ),
        config,
        findings,
        removed,
        tuple(r.alignment.remark for r in runs if r.alignment.remark),
    )


def _part_of(run: Run, solved: SolvedRun) -> DrivenPart:
    moved = np.ptp(solved.system.q, axis=0) > SAME_PLACE
    axes = tuple(a for a, own in zip(run.machine.axis_names, moved.tolist(), strict=True) if own)
    return DrivenPart(TOOL, len(run.path.points), run.alignment.coverage, axes)

# SPDX-License-Identifier: Apache-2.0
"""Recordings aligned, reduced, examined and solved: where calibrations and a diagnosis start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.contradictions.examine import examine
from otf_core.contradictions.outlier_places import LeftOut, findings, left_out
from otf_core.contradictions.recording_checks import check_recordings
from otf_core.contradictions.table_checks import check_table_pitch
from otf_core.live.stages import Progress, silent
from otf_core.memory import give_back, one_heap
from otf_core.pieces.finding import WARNING, Finding
from otf_core.pieces.methods import Preparation
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.solving.curve_lag import move_onto_curves
from otf_core.solving.model_choice import ReversalSolution, solve_with_reversal


@dataclass(frozen=True)
class Examined:
    """Recordings that are examined: solutions, corrections and a diagnosis start here.

    Attributes
    ----------
    runs : list of Run
        Mended where ``contradictions`` could mend them, with all their pieces.
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
class SolvedRecordings(Examined):
    """Recordings that are examined and solved.

    Attributes
    ----------
    solution : ReversalSolution
    left : tuple of LeftOut
        What was left out of every run as outliers.
    """

    solution: ReversalSolution[Run]
    left: tuple[LeftOut, ...]


def solve_recordings(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress = silent,
    prepare: Preparation = prepare_runs,
    *,
    mend: bool = True,
) -> SolvedRecordings:
    """Align, reduce to pieces, examine and solve.

    Parameters
    ----------
    recordings, config, progress, prepare
        As of ``calibrate_runs``.
    mend : bool
        Mend what can be mended, see ``contradictions.examine``.
    """
    one_heap()
    progress('aligning', 0.0)
    check_recordings(recordings)
    pitch = check_table_pitch(recordings[0].machine, config.piece_length)
    runs, nodes = prepare(recordings, config)
    give_back()

    progress('solving', 0.0)
    runs, contradictions = examine(runs, nodes, config, mend=mend)
    give_back()

    solution = solve_with_reversal(runs, nodes, config, progress)
    on_curves = move_onto_curves(runs, solution)
    if on_curves is not None:
        runs, solution = on_curves, solve_with_reversal(on_curves, nodes, config, progress)

    outliers = tuple(left_out(run, own) for run, own in zip(runs, solution.runs, strict=True))
    repairs = [Finding('recording', WARNING, text) for r in recordings for text in r.remarks]
    if pitch:
        repairs.append(Finding('table_pitch', WARNING, pitch.removeprefix('table_pitch: ')))
    stated = (*repairs, *contradictions, *findings(outliers))
    return SolvedRecordings(runs, nodes, stated, solution, outliers)

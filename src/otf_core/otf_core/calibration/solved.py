# SPDX-License-Identifier: Apache-2.0
"""Recordings aligned, reduced, examined and solved: where calibrations and a diagnosis start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.config import CalibrationConfig
from otf_core.contradictions.before import check_recordings
from otf_core.contradictions.examine import examine
from otf_core.contradictions.left_out import LeftOut, findings, left_out
from otf_core.live.stages import silent
from otf_core.memory import give_back, one_heap
from otf_core.pieces.finding import WARNING, Finding
from otf_core.pieces.methods import Preparation
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.solving.curve_lag import moved_onto_curves
from otf_core.solving.joint import Progress
from otf_core.solving.reversal_choice import (
    PlainSolution,
    ReversalSolution,
    solve_plainly,
    solve_with_reversal,
    with_reversal,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Examined:
    """Recordings that are examined: solutions, corrections and a diagnosis start here.

    Attributes
    ----------
    runs : list of Run
        Mended where ``contradictions`` could mend them, with all their pieces.
    nodes : mapping of axis to ndarray, m
        Table nodes.
    """

    runs: list[Run]
    nodes: dict[str, Array]

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
    left: tuple[LeftOut, ...] = ()


def examine_recordings(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress | None = None,
    prepare: Preparation = prepare_runs,
    *,
    mend: bool = True,
) -> Examined:
    """Align, reduce to pieces and examine; parameters as of ``solve_recordings``."""
    progress = progress or silent
    one_heap()
    progress('aligning', 0.0)
    check_recordings(recordings)
    runs, nodes = prepare(recordings, config)
    give_back()
    read = [Finding('recording', WARNING, text) for r in recordings for text in r.remarks]
    runs = _remarked(examine(runs, nodes, config, mend=mend), before=read)
    give_back()
    progress('solving', 0.0)
    return Examined(runs, nodes)


def solve_recordings(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress | None = None,
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
    progress = progress or silent
    found = examine_recordings(recordings, config, progress, prepare, mend=mend)
    plain = solve_plainly(found.runs, found.nodes, config, progress)
    return solve_on(found, plain, config, progress)


def solve_on(
    examined: Examined, plain: PlainSolution[Run], config: CalibrationConfig, progress: Progress
) -> SolvedRecordings:
    """Add the reversal to a solution of examined recordings, move them onto their curves."""
    runs, nodes = examined.runs, examined.nodes
    solution = with_reversal(plain, config, progress)
    moved = moved_onto_curves(runs, solution)
    if moved is not None:
        runs, solution = moved, solve_with_reversal(moved, nodes, config, progress)
    left = tuple(left_out(a, b) for a, b in zip(runs, solution.runs, strict=True))
    said = findings(left)
    solution = replace(solution, runs=_remarked(solution.runs, said))
    return SolvedRecordings(_remarked(runs, said), nodes, solution, left)


def _remarked(
    runs: Sequence[Run], after: Sequence[Finding] = (), before: Sequence[Finding] = ()
) -> list[Run]:
    """Let the first run carry what was found of all, before and after its own remarks."""
    first, *others = runs
    return [replace(first, remarks=(*before, *first.remarks, *after)), *others]

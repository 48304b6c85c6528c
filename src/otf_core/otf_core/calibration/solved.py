# SPDX-License-Identifier: Apache-2.0
"""Recordings aligned, reduced, examined and solved: where calibrations and a diagnosis start."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from otf_core.aside import Aside
from otf_core.config import CalibrationConfig
from otf_core.contradictions.before import check_recordings
from otf_core.contradictions.left_out import LeftOut, findings, left_out
from otf_core.errors import InputError
from otf_core.live.stages import silent
from otf_core.memory import give_back, one_heap
from otf_core.pieces.finding import WARNING, Finding
from otf_core.pieces.methods import Preparation
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.solving.curve_lag import moved_onto_curves
from otf_core.solving.joint import Progress
from otf_core.solving.reversal_choice import (
    Choice,
    PlainSolution,
    ReversalSolution,
    choose,
    solve_plainly,
    solve_with_reversal,
    with_reversal,
)

Array = NDArray[np.float64]

UNSOLVED = (InputError, ArithmeticError, ValueError, np.linalg.LinAlgError)
"""What solving runs may end with that nobody has examined."""


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


def _prepared(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress,
    prepare: Preparation,
) -> tuple[list[Run], dict[str, Array]]:
    """Align and reduce to pieces: runs and table nodes."""
    one_heap()
    progress('aligning', 0.0)
    check_recordings(recordings)
    runs, nodes = prepare(recordings, config)
    give_back()
    progress('solving', 0.0)
    return runs, nodes


def _examined(
    recordings: Sequence[Recording],
    runs: Sequence[Run],
    nodes: dict[str, Array],
    config: CalibrationConfig,
    *,
    mend: bool,
) -> list[Run]:
    """Examine runs; what was found as they were read is said first."""
    from otf_core.contradictions.examine import examine  # in the copy of the process alone

    read = [Finding('recording', WARNING, text) for r in recordings for text in r.remarks]
    found = _remarked(examine(runs, nodes, config, mend=mend), before=read)
    give_back()
    return found


def examined_and_solved(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress,
    prepare: Preparation = prepare_runs,
    *,
    mend: bool = True,
) -> tuple[Examined, PlainSolution[Run]]:
    """Align, reduce to pieces, examine, and solve without reversal.

    Most runs need no mending: where a copy of the process can examine them they are solved
    meanwhile, and anew if they are mended. Parameters as of ``solve_recordings``.
    """
    runs, nodes = _prepared(recordings, config, progress, prepare)
    plain = None
    with Aside(partial(_examined, recordings, runs, nodes, config, mend=mend), runs) as looking:
        if looking.under_way:
            with suppress(*UNSOLVED):  # told below, after what speaks against the runs
                plain = solve_plainly(runs, nodes, config, progress)
        found = looking.result()
    if plain is not None and _as_they_were(found, runs):
        first, *others = plain.runs
        kept = [replace(first, remarks=found[0].remarks), *others]
        plain = replace(plain, runs=kept)
    else:
        plain = solve_plainly(found, nodes, config, progress)
    return Examined(found, nodes), plain


def _as_they_were(examined: Sequence[Run], runs: Sequence[Run]) -> bool:
    """Tell whether nothing but remarks was added to runs."""
    names = [f.name for f in fields(Run) if f.name != 'remarks']
    if len(examined) != len(runs):
        return False
    pairs = zip(examined, runs, strict=True)
    return all(_same(getattr(a, n), getattr(b, n)) for a, b in pairs for n in names)


def _same(one: object, other: object) -> bool:
    return one is other or (isinstance(one, (str, int, float)) and one == other)


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
    examined, plain = examined_and_solved(recordings, config, progress, prepare, mend=mend)
    choice = choose(plain.runs, plain.done, config)
    return solve_on(examined, plain, choice, config, progress)


def solve_on(
    examined: Examined,
    plain: PlainSolution[Run],
    choice: Choice,
    config: CalibrationConfig,
    progress: Progress,
) -> SolvedRecordings:
    """Add a reversal to a solution of examined recordings, move them onto their curves."""
    runs, nodes = examined.runs, examined.nodes
    solution = with_reversal(plain, choice, config, progress)
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

# SPDX-License-Identifier: Apache-2.0
"""Where and why a real run departs from its simulation.

The calibration that the user gets, without reversal, which is a cause like any other; the same on
a simulation of the runs; a search for effects that explain the rest; their size on legs they were
not fitted on; where the gap lies; the calibration with the causes taken off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from otf_core.aside import Aside
from otf_core.calibration.calibrate import assemble
from otf_core.calibration.result import CalibrationResult
from otf_core.calibration.solved import (
    Examined,
    examined_and_solved,
    solve_on,
    solve_recordings,
)
from otf_core.calibration.with_effects import EffectsCalibration
from otf_core.config import CalibrationConfig
from otf_core.contradictions.left_out import left_out
from otf_core.diagnosis.answer import gap_of, known_words, named_causes, sentence_of
from otf_core.diagnosis.corrected import FoundCauses, with_causes, without_causes
from otf_core.diagnosis.engine.catalogue import (
    Found,
    Visibility,
    search_catalogue,
    spectral_lines,
)
from otf_core.diagnosis.engine.followed import held_by, rows_to_diagnose, straight_rows
from otf_core.diagnosis.engine.rows import Rows
from otf_core.diagnosis.engine.shaken import calmed
from otf_core.diagnosis.explanation import Explanation, explain
from otf_core.diagnosis.fitted import FittedCause, fitted_causes
from otf_core.diagnosis.judged import Judged, judge, run_views
from otf_core.diagnosis.moves import told_otherwise
from otf_core.diagnosis.place.where import Where, where_and_shape
from otf_core.diagnosis.result import Diagnosis, Gap, NamedCause, Shown
from otf_core.diagnosis.simulated import Twin, simulated_residual_um
from otf_core.effects import REGISTRY, Effect
from otf_core.errors import InputError
from otf_core.live.stages import silent
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.pieces.finding import Finding
from otf_core.pieces.runs import Recording, Run
from otf_core.solving.basis import Basis
from otf_core.solving.joint import JointSolution, Progress
from otf_core.solving.reversal_choice import PlainSolution, choose
from otf_core.threads import in_one_thread

Array = NDArray[np.float64]

ALL_SAMPLES = 100.0
"""Robust deviations: the largest ``outlier_limit``, beyond all but reflections."""


@in_one_thread
def diagnose(
    recordings: Sequence[Recording],
    twin: Twin,
    exclude: Sequence[str] = (),
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
    own: Sequence[Effect] = (),
) -> Diagnosis:
    """Diagnose runs of one machine.

    Parameters
    ----------
    recordings : sequence of Recording
        No time relation between samples and path is needed.
    twin : callable
        Simulates a run again: ``sim.twin.twin_recording``.
    exclude : sequence of str
        Effects taken out of the catalogue.
    config : CalibrationConfig, optional
        Of the calibration.
    progress : callable(stage, fraction), optional
        Called as work goes on, stage 'aligning', 'solving', 'diagnosing' or 'correcting'.
    own : sequence of Effect
        Causes of one's own, tried beside the catalogue.

    Raises
    ------
    InputError
        As ``calibrate_runs``.
    """
    config = config or CalibrationConfig()
    progress = progress or silent
    with ExitStack() as aside:
        as_recorded = partial(_as_recorded, recordings, config)
        uncut = Aside(partial(as_recorded, mend=True), recordings, later=True)
        aside.enter_context(uncut)  # in case it is needed
        examined, plain = examined_and_solved(recordings, config, progress)
        whole = len(examined.runs) == len(recordings)
        done = Aside(partial(_calibrated, examined, plain, config), later=True)
        aside.enter_context(done)
        seen = _Seen(plain.runs, plain.done, examined.nodes)
        if any(len(run.pieces.bend) for run in examined.runs):
            examined, seen = done.result().moved or (examined, seen)
        del plain
        if _by_machine(examined.runs, seen.runs):
            seen = uncut.result() if whole else as_recorded(mend=False)
        elif not whole:
            seen = _solved_uncut(recordings, config, mend=False)
        uncut.stop()
        searched = _searched(seen, twin, exclude, config, progress, own)
        progress('diagnosing', 0.7)
        calibrated = done.result()
    first, *others = examined.runs
    examined = replace(examined, runs=[replace(first, remarks=calibrated.remarks), *others])
    explained = explain(searched.rows, searched.found.causes, searched.simulated_um)
    bases = seen.done.unknowns.bases
    causes = partial(_causes, bases=bases, examined=examined)
    fitted = fitted_causes(explained.causes, searched.rows)
    weigh = partial(_weighed, searched, explained, config, exclude)
    made = None
    with Aside(weigh, (searched, explained)) as weighing:
        if weighing.under_way:  # here the correction, which takes longer, has copies of its own
            with suppress(InputError):  # told below, if the causes stay
                made = without_causes(examined, causes(fitted), config)
        weighed = weighing.result()
    progress('correcting', 0.0)
    if not weighed.fitted:
        made = None
    elif made is None:
        made = without_causes(examined, causes(fitted), config)
    beside = partial(with_causes, calibrated.result, made, causes(weighed.fitted), config)
    return _diagnosis(recordings, examined, searched, weighed, beside)


@dataclass(frozen=True)
class _Calibrated:
    """The calibration that the user gets.

    Attributes
    ----------
    result : CalibrationResult
    remarks : tuple of Finding
        What is said of all runs, as the first carries it.
    moved : (Examined, _Seen) or None
        Where runs were moved onto their curves: these, and what is diagnosed of them.
    """

    result: CalibrationResult
    remarks: tuple[Finding, ...]
    moved: tuple[Examined, _Seen] | None


def _calibrated(
    examined: Examined, plain: PlainSolution[Run], config: CalibrationConfig
) -> _Calibrated:
    """Go on from a solution without reversal to the calibration that the user gets."""
    choice = choose(plain.runs, plain.done, config)
    solved = solve_on(examined, plain, choice, config, silent)
    pairs = zip(solved.runs, examined.runs, strict=True)
    moved = None
    if any(new.pieces is not old.pieces for new, old in pairs):
        seen = _Seen(*solved.solution.plain, solved.nodes)
        moved = Examined(solved.runs, solved.nodes), seen
    return _Calibrated(assemble(solved.solution, config), solved.runs[0].remarks, moved)


@dataclass(frozen=True)
class _Searched:
    """Rows, what is found in them, and the residual of their simulation."""

    rows: Rows
    found: Found
    simulated_um: float


def _searched(
    seen: _Seen,
    twin: Twin,
    exclude: Sequence[str],
    config: CalibrationConfig,
    progress: Progress,
    own: Sequence[Effect],
) -> _Searched:
    """Search what the calibration leaves for effects."""
    rows = rows_to_diagnose(seen.runs, seen.done, seen.nodes, config, exclude)
    simulated = partial(simulated_residual_um, nodes=seen.nodes, config=config, twin=twin)
    straight = partial(
        straight_rows, done=seen.done, nodes=seen.nodes, config=config, exclude=exclude
    )
    calm = partial(calmed, config=config)
    progress('diagnosing', 0.0)
    with Aside(partial(simulated, rows)) as simulating:
        lines, first = spectral_lines(rows), rows
        found = search_catalogue(rows, exclude, own, lines)
        for changed in (straight, calm, straight):  # loud noise may have hidden straight lines
            other = changed(rows, found.causes)
            if other is not None:
                rows, found = other, search_catalogue(other, exclude, own, lines)
        left = simulating.result() if rows is first else simulated(rows)
    return _Searched(rows, found, left)


@dataclass(frozen=True)
class _Seen:
    """What is diagnosed: runs as they were kept, their solution without reversal, table nodes."""

    runs: list[Run]
    done: JointSolution
    nodes: dict[str, Array]


@dataclass(frozen=True)
class _Weighed:
    """Causes after what else could be, and where the gap lies.

    Attributes
    ----------
    judged : Judged
    fitted : tuple of FittedCause
    gap : Gap
    causes : tuple of NamedCause
    where : Where
    shape : str
    """

    judged: Judged
    fitted: tuple[FittedCause, ...]
    gap: Gap
    causes: tuple[NamedCause, ...]
    where: Where
    shape: str


def _weighed(
    searched: _Searched, explained: Explanation, config: CalibrationConfig, exclude: Sequence[str]
) -> _Weighed:
    """Weigh the causes found, name those that stay, and tell where the gap lies."""
    rows = searched.rows
    judged = judge(rows, explained, config, exclude)
    explained, nameless = judged.explained, judged.nameless
    fitted, gap = fitted_causes(explained.causes, rows), gap_of(explained, judged.noise)
    causes = named_causes(explained, fitted, judged.noise_cause, gap, rows.states)
    where, shape = where_and_shape(
        run_views(rows, explained),
        project=rows.project,
        known=known_words(causes, nameless.said if nameless else None),
        certain=nameless is None,
    )
    return _Weighed(judged, tuple(fitted), gap, causes, where, shape)


def _by_machine(runs: Sequence[Run], kept: Sequence[Run]) -> bool:
    """Tell whether what is left out as outliers is what the machine does."""
    return any(left_out(run, own).by_machine for run, own in zip(runs, kept, strict=True))


def _as_recorded(
    recordings: Sequence[Recording], config: CalibrationConfig, *, mend: bool
) -> _Seen:
    """Solve runs with all their samples: what the machine does is in the gap, however large."""
    return _solved_uncut(recordings, replace(config, outlier_limit=ALL_SAMPLES), mend=mend)


def _solved_uncut(
    recordings: Sequence[Recording], config: CalibrationConfig, *, mend: bool
) -> _Seen:
    """Solve runs without reversal, as everything that is diagnosed.

    Uncut where the calibration cut them at a step, which then is not mended: it is in the gap.
    """
    solved = solve_recordings(recordings, replace(config, reversal='none'), mend=mend)
    return _Seen(*solved.solution.plain, solved.nodes)


def _causes(
    fitted: Sequence[FittedCause], bases: dict[str, Basis], examined: Examined
) -> FoundCauses:
    """Causes with their parameters, for every examined run, less what fine functions hold."""
    off = [part for part in fitted if not held_by(part.cause.option, bases)]
    return FoundCauses(
        tuple((part.cause.confidence, part.cause.indistinguishable) for part in off),
        tuple(tuple(part.applied(k) for part in off) for k in examined.source),
    )


def _diagnosis(
    recordings: Sequence[Recording],
    examined: Examined,
    searched: _Searched,
    weighed: _Weighed,
    beside: Callable[[str], EffectsCalibration],
) -> Diagnosis:
    """Put everything into words; ``beside`` makes the calibration for a sentence."""
    rows, visible, judged = searched.rows, searched.found.visible, weighed.judged
    explained, nameless, causes = judged.explained, judged.nameless, weighed.causes
    applied = tuple(
        tuple(part.applied(k) for part in weighed.fitted) for k in range(len(rows.runs))
    )
    said = nameless.said if nameless else None
    sentence = sentence_of(judged.verdict, weighed.gap, causes, judged.noise, said)
    calibration = beside(sentence)
    return Diagnosis(
        runs=tuple(r.name or f'run {k}' for k, r in enumerate(recordings, start=1)),
        verdict=judged.verdict,
        sentence=sentence,
        gap=weighed.gap,
        causes=causes,
        unexplained_um=weighed.gap.after_um,
        unexplained_where=judged.left if explained.causes else weighed.shape,
        not_visible=_not_visible(visible, causes),
        where=weighed.where,
        considered=searched.found.considered,
        smallest_found_um={
            n: 1e6 * v.smallest for n, v in visible.items() if np.isfinite(v.smallest)
        },
        contradictions=told_otherwise(examined.runs[0].remarks, said),
        table_change_um=_table_change_um(calibration),
        unnamed=said,
        applied=nameless.applied if nameless else applied,
        calibration=calibration,
        origin=calibration.plain.origin,
        shown=Shown(run_views(rows, explained), _conditions(examined, calibration.plain)),
    )


def _not_visible(
    visible: dict[str, Visibility], causes: Sequence[NamedCause]
) -> tuple[tuple[str, str], ...]:
    """Effects that leave no trace in these data, and what would show them."""
    named = {c.effect for c in causes} | {n for c in causes for n in c.indistinguishable_from}
    hidden = [n for n, v in visible.items() if not v.visible and n not in named]
    return tuple((n, REGISTRY[n].needs) for n in hidden)


def _table_change_um(calibration: EffectsCalibration) -> float:
    tables, other = calibration.plain.tables, calibration.result.tables
    points = lattice(tables.machine)
    change = displacement(other, points) - displacement(tables, points)
    return 1e6 * mean_length(without_rigid_motion(change, points))


def _conditions(examined: Examined, plain: CalibrationResult) -> dict[str, str]:
    first = examined.runs[0]
    return {
        'machine': first.machine.name,
        'chain': str(first.machine.chain),
        'samples': ', '.join(str(r.samples) for r in plain.runs),
        'path pieces': ', '.join(str(len(r.pieces)) for r in plain.runs),
        'reversal in the calibration': plain.reversal.model,
        'tracker noise, as measured in standstills': str(first.noise),
    }

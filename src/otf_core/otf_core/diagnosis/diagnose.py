# SPDX-License-Identifier: Apache-2.0
"""Where and why a real run departs from its simulation.

The calibration that the user gets, without reversal, which is a cause like any other; the same on
a simulation of the runs; a search for effects that explain the rest; their size on legs they were
not fitted on; where the gap lies; the calibration with the causes taken off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from otf_core.calibration.calibrate import SolvedRecordings, assemble, solve_recordings
from otf_core.calibration.result import CalibrationResult
from otf_core.calibration.with_effects import EffectsCalibration
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.answer import gap_of, known_words, named_causes, sentence_of
from otf_core.diagnosis.corrected import with_causes
from otf_core.diagnosis.engine.assess import Residuals, gap_um
from otf_core.diagnosis.engine.catalogue import (
    Found,
    Visibility,
    search_catalogue,
    spectral_lines,
)
from otf_core.diagnosis.engine.followed import held_by, rows_to_diagnose, straight_rows
from otf_core.diagnosis.engine.noise_check import NoiseFinding, check_noise
from otf_core.diagnosis.engine.rival import Rival, rival_of
from otf_core.diagnosis.engine.rows import Rows
from otf_core.diagnosis.engine.shaken import calmed
from otf_core.diagnosis.engine.unnamed import (
    AS_RIVALS,
    SCREENED,
    try_structures,
)
from otf_core.diagnosis.explanation import Explanation, explain
from otf_core.diagnosis.fitted import fitted_causes
from otf_core.diagnosis.place.views import RunView
from otf_core.diagnosis.place.where import describe_structure, where_and_shape
from otf_core.diagnosis.place.where_words import EVERYWHERE, NO_STRUCTURE
from otf_core.diagnosis.result import Diagnosis, NamedCause, Shown
from otf_core.diagnosis.simulated import Twin, simulated_residual_um
from otf_core.diagnosis.unnamed import Nameless, find_unnamed
from otf_core.diagnosis.verdict import Case, matters, verdict_of
from otf_core.effects import REGISTRY, Effect
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.pieces.runs import Recording
from otf_core.solving.joint import Progress
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
        Called as work goes on, stage 'aligning', 'solving', 'simulating', 'diagnosing' or
        'correcting'.
    own : sequence of Effect
        Causes of one's own, tried beside the catalogue.

    Raises
    ------
    InputError
        As ``calibrate_runs``.
    """
    config = config or CalibrationConfig()
    progress = progress or (lambda stage, fraction: None)
    solved = solve_recordings(recordings, config, progress)
    plain = assemble(solved.solution, config)
    solved = _without_reversal(solved)
    seen = _as_recorded(solved, recordings, config)
    rows, found, simulated_um = _searched(seen, twin, exclude, config, progress, own)
    progress('diagnosing', 0.5)
    judged = _judged(rows, explain(rows, found.causes, simulated_um), config, exclude)
    explained, noise, nameless = judged.explained, judged.noise, judged.nameless
    fitted = fitted_causes(explained.causes, rows)
    applied = tuple(tuple(part.applied(k) for part in fitted) for k in range(len(rows.runs)))
    gap = gap_of(explained, noise)
    causes = named_causes(explained, fitted, judged.noise_cause, gap, rows.states)
    said = nameless.said if nameless else None
    sentence = sentence_of(judged.verdict, gap, causes, noise, said)
    views = run_views(rows, explained)
    known = known_words(causes, said)
    where, shape = where_and_shape(
        views, project=rows.project, known=known, certain=nameless is None
    )
    told = [(c.confidence, c.indistinguishable) for c in explained.causes]
    verdict, left = judged.verdict, judged.left if told else shape
    bases = seen.solution.plain[1].unknowns.bases
    off = [k for k, part in enumerate(fitted) if not held_by(part.cause.option, bases)]
    visible, considered = found.visible, found.considered
    views = tuple(replace(v) for v in views)  # without what they have worked out
    del rows, seen, found, judged, explained, fitted  # their memory is needed now
    progress('correcting', 0.0)
    taken = [tuple(applied[k][i] for i in off) for k in solved.source]
    calibration = with_causes(solved, plain, [told[i] for i in off], taken, config, sentence)
    return Diagnosis(
        runs=tuple(r.name or f'run {k}' for k, r in enumerate(recordings, start=1)),
        verdict=verdict,
        sentence=sentence,
        gap=gap,
        causes=causes,
        unexplained_um=gap.after_um,
        unexplained_where=left,
        not_visible=_not_visible(visible, causes),
        where=where,
        considered=considered,
        smallest_found_um={
            n: 1e6 * v.smallest for n, v in visible.items() if np.isfinite(v.smallest)
        },
        contradictions=solved.runs[0].remarks,
        table_change_um=_table_change_um(calibration),
        unnamed=said,
        applied=nameless.applied if nameless else applied,
        calibration=calibration,
        origin=plain.origin,
        shown=Shown(views, _conditions(solved, plain)),
    )


def _searched(
    seen: SolvedRecordings,
    twin: Twin,
    exclude: Sequence[str],
    config: CalibrationConfig,
    progress: Progress,
    own: Sequence[Effect],
) -> tuple[Rows, Found, float]:
    """Rows, what is found in them, and the residual of their simulation."""
    plain = seen.solution.plain
    rows = rows_to_diagnose(*plain, seen.nodes, config, exclude)
    progress('simulating', 0.0)
    simulated_um = simulated_residual_um(rows, seen.nodes, config, twin)
    progress('diagnosing', 0.0)
    lines, first = spectral_lines(rows), rows
    found = search_catalogue(rows, exclude, own, lines)
    straight = partial(
        straight_rows, done=plain[1], nodes=seen.nodes, config=config, exclude=exclude
    )
    calm = partial(calmed, config=config)
    for changed in (straight, calm, straight):  # loud noise may have hidden that lines are right
        other = changed(rows, found.causes)
        if other is not None:
            rows, found = other, search_catalogue(other, exclude, own, lines)
    if rows is not first:
        simulated_um = simulated_residual_um(rows, seen.nodes, config, twin)
    return rows, found, simulated_um


@dataclass(frozen=True)
class _Judged:
    """What a search gave, after what else could be.

    Attributes
    ----------
    verdict : str
    explained : Explanation
        Without causes where they are not enough.
    noise : NoiseFinding or None
    left : str
        Where what the causes leave lies.
    nameless : Nameless or None
    """

    verdict: str
    explained: Explanation
    noise: NoiseFinding | None
    left: str
    nameless: Nameless | None

    @property
    def noise_cause(self) -> NoiseFinding | None:
        """Noise as a cause: not where something is there that nobody knows."""
        return None if self.verdict == 'unknown' else self.noise


def _judged(
    rows: Rows, explained: Explanation, config: CalibrationConfig, exclude: Sequence[str]
) -> _Judged:
    """Weigh the causes found against noise, and against what has no name."""
    gap = matters(explained.after_um, explained.simulated_um)
    noise = check_noise(rows, config.standstill_speed, exclude, gap=gap)
    left, has_place = _what_is_left(rows, explained)
    verdict = verdict_of(_case(explained, noise, has_place=has_place))
    explained, nameless = _or_something_else(rows, explained, verdict)
    verdict = 'unknown' if nameless else verdict
    if verdict == 'unknown':
        known = nameless.simulated_um if nameless else explained.simulated_um
        explained = explained.without_causes(known)
    elif noise and verdict == 'none':
        verdict = 'explained'
    return _Judged(verdict, explained, noise, left, nameless)


def _without_reversal(solved: SolvedRecordings) -> SolvedRecordings:
    """Let go of the solution with reversal, which is as large again as the one without."""
    kept, done = solved.solution.plain
    return replace(solved, solution=replace(solved.solution, runs=kept, done=done))


def _as_recorded(
    solved: SolvedRecordings, recordings: Sequence[Recording], config: CalibrationConfig
) -> SolvedRecordings:
    """Solve runs uncut where the calibration cut them at a step: the step is in the gap.

    So is what was left out as outliers, but is what the machine does. Without reversal, as
    everything that is diagnosed.
    """
    whole, real = len(solved.runs) == len(recordings), any(r.by_machine for r in solved.left)
    if whole and not real:
        return solved
    limit = ALL_SAMPLES if real else config.outlier_limit
    uncut = replace(config, outlier_limit=limit, reversal='none')
    return solve_recordings(recordings, uncut, mend=whole)


def _or_something_else(
    rows: Rows, explained: Explanation, verdict: str
) -> tuple[Explanation, Nameless | None]:
    """Doubt the names for what else may explain the gap; that, where it is to be said instead."""
    if explained.causes:
        tried = try_structures(rows, AS_RIVALS if verdict == 'explained' else SCREENED)
        rival = rival_of(explained.causes, tried)
    elif verdict == 'unknown':
        tried, rival = try_structures(rows, SCREENED), Rival()
    else:
        return explained, None
    return explained.doubted(rival), find_unnamed(rows, explained, verdict, tried, rival)


def _what_is_left(rows: Rows, explained: Explanation) -> tuple[str, bool]:
    """Shape of what the causes leave, and whether what all that is known leaves has a place."""
    if not explained.causes:
        return NO_STRUCTURE, False

    def shape(rest: Residuals) -> str:
        views = run_views(rows, explained, rest)
        return describe_structure(views, 'residual_after', rows.project)

    left = shape(explained.fitted)
    same = explained.known_rest is explained.fitted
    rest = left if same else shape(explained.known_rest)
    return left, rest not in (NO_STRUCTURE, EVERYWHERE)


def _case(explained: Explanation, noise: NoiseFinding | None, *, has_place: bool) -> Case:
    """What the verdict depends on, with noise as found in the simulation."""
    simulated = explained.simulated_um * (1.0 if noise is None else noise.level)
    return Case(
        simulated_um=simulated,
        before_um=gap_um(explained.steps[0].rms_um, simulated),
        after_um=gap_um(explained.steps[-1].rms_um, simulated),
        beyond_um=gap_um(explained.known_um, simulated),
        named=bool(explained.causes),
        structured=explained.structured,
        left_has_place=has_place,
        decoyed=explained.decoyed,
    )


def _not_visible(
    visible: dict[str, Visibility], causes: Sequence[NamedCause]
) -> tuple[tuple[str, str], ...]:
    """Effects that leave no trace in these data, and what would show them."""
    named = {c.effect for c in causes} | {n for c in causes for n in c.indistinguishable_from}
    hidden = [n for n, v in visible.items() if not v.visible and n not in named]
    return tuple((n, REGISTRY[n].needs) for n in hidden)


def run_views(
    rows: Rows, explained: Explanation, rest: Residuals | None = None
) -> tuple[RunView, ...]:
    """Plain arrays of every run, with the residuals without causes and with them (``rest``)."""
    rest = rest or explained.fitted
    parts = rows.by_run(explained.steps[0].rows), rows.by_run(rest.rows)
    return tuple(
        RunView(
            name=run.recording.name or f'run {k}',
            axis_names=state.machine.axis_names,
            time=state.time,
            leg=run.pieces.leg,
            q=state.q,
            direction=state.direction,
            speed=state.speed,
            beam=state.beam,
            axes=solved.system.axes,
            residual_before=before,
            residual_after=after,
            expected=whitener.expected,
            factors=whitener.factors,
        )
        for k, (run, solved, whitener, state, before, after) in enumerate(
            zip(rows.runs, rows.done.runs, rows.whiteners, rows.states, *parts, strict=True),
            start=1,
        )
    )


def _table_change_um(calibration: EffectsCalibration) -> float:
    tables, other = calibration.plain.tables, calibration.result.tables
    points = lattice(tables.machine)
    change = displacement(other, points) - displacement(tables, points)
    return 1e6 * mean_length(without_rigid_motion(change, points))


def _conditions(solved: SolvedRecordings, plain: CalibrationResult) -> dict[str, str]:
    first = solved.runs[0]
    return {
        'machine': first.machine.name,
        'chain': str(first.machine.chain),
        'samples': ', '.join(str(r.samples) for r in plain.runs),
        'path pieces': ', '.join(str(len(r.pieces)) for r in plain.runs),
        'reversal in the calibration': plain.reversal.model,
        'tracker noise, as measured in standstills': str(first.noise),
    }

# SPDX-License-Identifier: Apache-2.0
"""Where and why a real run departs from its simulation.

Plain calibration; the same on the twin of the run (what would be left if nothing were
unmodelled); search for effects that explain the rest; their size on legs they were not fitted
on; what the data could not show.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from otf_core.config import CalibrationConfig
from otf_core.contradictions.before import check_recordings
from otf_core.contradictions.examine import examine
from otf_core.diagnosis.engine.assess import Residuals, gap_um, plain_residuals, residuals_with
from otf_core.diagnosis.engine.catalogue import (
    Visibility,
    collect_options,
    effects_without,
    shapes_from_lines,
    spectral_lines,
)
from otf_core.diagnosis.engine.decoys import DECOY_NAMES, DECOYS
from otf_core.diagnosis.engine.rows import Rows, build_rows
from otf_core.diagnosis.engine.search import Cause, fit_out, noise_variance, search
from otf_core.effects import Effect
from otf_core.model.frames import RigidTransform
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.solving.joint import JointSolution, Progress, solve_jointly
from otf_core.solving.shape_choice import choose_shapes
from otf_core.solving.unknowns import layout
from otf_core.threads import one_thread

Array = NDArray[np.float64]
Twin = Callable[[Run, RigidTransform, ErrorTables, int], Recording]

MATERIAL_SHARE = 0.12
"""Least share of a further cause in the gap, as amplitude."""
NO_GAP_SHARE = 0.35
"""Gap over simulated residual below which there is nothing to explain."""
PLAIN_GAP_SHARE = 0.6
"""The same for a residual without structure: the level of noise is known to ten percent only."""
EXPLAINED_SHARE, KNOWN_SHARE = 0.3, 0.55
"""Share of the gap left (as amplitude) up to which it counts as explained; as known at all."""
PLACED_EXPLAINED_SHARE, PLACED_KNOWN_SHARE = 0.1, 0.25
"""The same where what is left has a place or a shape: a cause leaves noise, a wrong one a part of
the true one."""
FREE_OF_STRUCTURE = 1.2
"""Correlation of neighbouring pieces below which residuals count as noise."""
NOISE_RANGE = (0.7, 1.4)
"""Variances by which the twin's noise may be corrected."""


@dataclass(frozen=True)
class Findings:
    """Everything a diagnosis computed, for report and files.

    Attributes
    ----------
    rows : Rows
    causes : tuple of Cause
        Effects of the catalogue, in the order found.
    simulated_um : float
    steps : tuple of Residuals
        Without causes, with the first, with the first two ... (held out).
    fitted : Residuals
        With all causes fitted to all legs.
    visible : mapping of effect name to Visibility
    considered : tuple of (name, log odds)
    structured : bool
        True if neighbouring pieces share more of the residual than noise explains.
    known_um : float
        Residual with the effects of the catalogue that the data speak for, too small ones to be
        named included (held out), um.
    known_rest : Residuals
        The same, fitted to all legs.
    left_has_place : bool
        True if that rest stands out somewhere.
    decoyed : bool
        True if shapes outside the catalogue explain more than the causes.
    """

    rows: Rows
    causes: tuple[Cause, ...]
    simulated_um: float
    steps: tuple[Residuals, ...]
    fitted: Residuals
    visible: dict[str, Visibility]
    considered: tuple[tuple[str, float], ...]
    known_um: float
    known_rest: Residuals
    structured: bool = True
    left_has_place: bool = False
    decoyed: bool = False


def _solved(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    progress: Progress,
    *,
    examined: bool = False,
) -> tuple[list[Run], JointSolution]:
    runs, nodes = prepare_runs(recordings, config)
    if examined:
        runs = examine(runs, nodes, config, mend=False)
    shapes = choose_shapes(runs, nodes, config, progress)
    unknowns = layout(shapes.bases, len(runs))
    return runs, solve_jointly(shapes.runs, unknowns, config, progress, shapes.start)


def simulated_residual_um(
    rows: Rows, config: CalibrationConfig, twin: Twin, seed: int = 1
) -> float:
    """Residual that the same pipeline leaves on the twins of the runs, um."""
    recordings = [
        twin(run, solved.pose, rows.tables, seed + k)
        for k, (run, solved) in enumerate(zip(rows.runs, rows.done.runs, strict=True))
    ]
    runs, done = _solved(recordings, config, lambda stage, fraction: None)
    return plain_residuals(build_rows(runs, done, config.unidentifiable_above)).rms_um


def _material(effect: Effect, before: Residuals, after: Residuals, whole_um: float) -> bool:
    """Tell whether a cause matters: by its own trace, and beside the whole gap."""
    trace = float(np.sqrt(max(0.0, before.rms_um**2 - after.rms_um**2)))
    return trace > effect.material_um and trace > MATERIAL_SHARE * whole_um


def find(
    recordings: Sequence[Recording],
    twin: Twin,
    exclude: Sequence[str] = (),
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> Findings:
    """Search runs of one machine for effects.

    Parameters
    ----------
    recordings : sequence of Recording
    twin : callable
        ``sim.twin.twin_recording``.
    exclude : sequence of str
        Effects taken out of the catalogue.
    config : CalibrationConfig, optional
    progress : callable(stage, fraction), optional
    """
    config = config or CalibrationConfig()
    progress = progress or (lambda stage, fraction: None)
    with one_thread():
        check_recordings(recordings)
        runs, done = _solved(recordings, config, progress, examined=True)
        progress('simulating', 0.0)
        rows = build_rows(runs, done, config.unidentifiable_above)
        simulated = simulated_residual_um(rows, config, twin)
        progress('diagnosing', 0.0)
        shapes = shapes_from_lines(spectral_lines(rows))
        effects = [*effects_without(exclude), *DECOYS]
        options, visible = collect_options(rows, effects, shapes)
        progress('diagnosing', 0.5)
        found, considered = search(rows, options)
        progress('diagnosing', 0.8)
        simulated *= _noise_level(rows, found)
        causes, steps = _named(rows, found, simulated)
        decoyed = _decoyed(causes, steps)
        kept = [c for c in causes if _in_catalogue(c)]
        if len(kept) < len(causes):  # what a decoy takes away is not explained
            causes = kept
            steps = [residuals_with(rows, kept[:k]) for k in range(len(kept) + 1)]
        fitted = residuals_with(rows, causes, held_out=False)
        # what is found after a decoy lives on what that left
        first = takewhile(_in_catalogue, found)
        known = [*causes, *(c for c in first if all(c is not named for named in causes))]
        known_um, rest = steps[-1].rms_um, fitted
        if len(known) > len(causes):
            known_um = min(known_um, residuals_with(rows, known).rms_um)
            rest = residuals_with(rows, known, held_out=False)
    sight = {n: v for n, v in visible.items() if n not in DECOY_NAMES}
    return Findings(
        rows,
        tuple(causes),
        simulated,
        tuple(steps),
        fitted,
        sight,
        tuple(considered),
        known_um,
        rest,
        _structure(rows, rows.residual) > FREE_OF_STRUCTURE,
        decoyed=decoyed,
    )


def _named(
    rows: Rows, found: Sequence[Cause], simulated: float
) -> tuple[list[Cause], list[Residuals]]:
    """Causes that matter, and the residuals step by step."""
    causes: list[Cause] = []
    steps = [plain_residuals(rows)]
    whole = gap_um(steps[0].rms_um, simulated)
    for cause in found:
        after = residuals_with(rows, [*causes, cause])
        if _material(cause.option.effect, steps[-1], after, whole):
            causes.append(cause)
            steps.append(after)
    return causes, steps


def _noise_level(rows: Rows, found: Sequence[Cause]) -> float:
    """Correction of the twin's noise, from what the causes leave.

    How fast noise averages out over a piece is known to some ten percent from short stops. If
    what is left has no structure, its size tells better.
    """
    residual = rows.residual
    for cause in found:
        residual = fit_out(cause.option, residual)
    structure = _structure(rows, residual)
    variance = float(np.mean(residual**2)) * len(residual) / (len(residual) - rows.base.shape[1])
    if structure > FREE_OF_STRUCTURE or not NOISE_RANGE[0] < variance < NOISE_RANGE[1]:
        return 1.0
    return float(np.sqrt(variance))


def _structure(rows: Rows, residual: Array) -> float:
    """Inflation by the correlation of neighbouring pieces; 1 for noise as assumed."""
    return noise_variance(rows, residual) / max(float(np.mean(residual**2)), 1.0)


def _in_catalogue(cause: Cause) -> bool:
    return cause.option.effect.name not in DECOY_NAMES


def _decoyed(causes: Sequence[Cause], steps: Sequence[Residuals]) -> bool:
    """Tell whether shapes outside the catalogue explain more than the effects named."""
    power = {True: 0.0, False: 0.0}
    for cause, before, after in zip(causes, steps[:-1], steps[1:], strict=True):
        power[not _in_catalogue(cause)] += max(0.0, before.rms_um**2 - after.rms_um**2)
    return power[True] > power[False]


def verdict_of(findings: Findings) -> str:
    """Verdict on the gap (INTERFACES section 6)."""
    simulated = findings.simulated_um
    before = gap_um(findings.steps[0].rms_um, simulated)
    after = gap_um(findings.steps[-1].rms_um, simulated)
    if findings.decoyed:
        return 'unknown'
    if not findings.causes:
        least = NO_GAP_SHARE if findings.structured else PLAIN_GAP_SHARE
        return 'none' if before < least * simulated else 'unknown'
    explained, known = EXPLAINED_SHARE, KNOWN_SHARE
    if findings.left_has_place:
        explained, known = PLACED_EXPLAINED_SHARE, PLACED_KNOWN_SHARE
    beyond = gap_um(findings.known_um, simulated)
    if beyond > max(known * before, NO_GAP_SHARE * simulated):
        return 'unknown'
    left = after if after > NO_GAP_SHARE * simulated else 0.0
    return 'explained' if left <= explained * before else 'partly_explained'

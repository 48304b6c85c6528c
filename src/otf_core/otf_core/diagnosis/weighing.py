# SPDX-License-Identifier: Apache-2.0
"""Causes found weighed against noise, and against what has no name: the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from otf_core.aside import shared_out
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.empirical_structure import AS_RIVALS, SCREENED, try_structures
from otf_core.diagnosis.engine.gap_sizes import Residuals, gap_um
from otf_core.diagnosis.engine.noise_check import NoiseFinding, check_noise
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.rival import Rival, rival_of
from otf_core.diagnosis.explanation import Explanation
from otf_core.diagnosis.place.views import RunView
from otf_core.diagnosis.place.where import describe_structure
from otf_core.diagnosis.place.where_words import EVERYWHERE, NO_STRUCTURE
from otf_core.diagnosis.unnamed_cause import Nameless, find_unnamed
from otf_core.diagnosis.verdict import Case, matters, verdict_of


@dataclass(frozen=True)
class Judged:
    """What a search gave, after what else could be.

    Attributes
    ----------
    explained : Explanation
        Without causes where they are not enough.
    left : str
        Where what the causes leave lies.
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


def judge(
    rows: Rows, explained: Explanation, config: CalibrationConfig, exclude: Sequence[str]
) -> Judged:
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
    return Judged(verdict, explained, noise, left, nameless)


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

    same = explained.known_rest is explained.fitted
    looked = [explained.fitted] if same else [explained.fitted, explained.known_rest]
    left, rest = (shared_out(shape, looked) * 2)[:2]
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

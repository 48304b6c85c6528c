# SPDX-License-Identifier: Apache-2.0
"""From findings to an answer: verdict, gap, causes with sizes, what the data could not show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.diagnose import Findings, verdict_of
from otf_core.diagnosis.engine.assess import gap_um, shrink_interval, shrink_percent
from otf_core.diagnosis.engine.noise_check import NoiseFinding
from otf_core.diagnosis.engine.search import Cause, fit_jointly
from otf_core.diagnosis.place.views import RunView
from otf_core.diagnosis.place.where import Where
from otf_core.diagnosis.result import Diagnosis, Gap, NamedCause
from otf_core.effects import REGISTRY, AppliedEffect

Array = NDArray[np.float64]

SIGNIFICANT = 2.0
"""Standard deviations at which an axis takes part in a cause."""


@dataclass(frozen=True)
class DiagnosisData:
    """What figures and files need besides the diagnosis.

    Attributes
    ----------
    findings : Findings
    views : tuple of RunView
    conditions : mapping of str to str
    applied : tuple of tuple of AppliedEffect
        For every run the causes with their fitted parameters, ready for a simulation.
    """

    findings: Findings
    views: tuple[RunView, ...]
    conditions: Mapping[str, str]
    applied: tuple[tuple[AppliedEffect, ...], ...]


@dataclass(frozen=True)
class _Fitted:
    """Parameters of one cause."""

    cause: Cause
    value: Array
    u: Array

    @property
    def names(self) -> list[str]:
        return [self.cause.option.terms.names[i] for i in self.cause.option.take]

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes whose coefficients are significant, strongest first."""
        option = self.cause.option
        strength: dict[str, float] = {}
        for i, value, u, size in zip(option.take, self.value, self.u, option.size, strict=True):
            axis = option.terms.axes[i]
            if axis and abs(value) > SIGNIFICANT * u:
                strength[axis] = strength.get(axis, 0.0) + (value * size) ** 2
        largest = max(strength.values(), default=0.0)
        kept = {a: s for a, s in strength.items() if s > 0.02 * largest}
        return tuple(sorted(kept, key=lambda a: -kept[a]))

    def applied(self, run: int) -> AppliedEffect:
        """The effect with its fitted parameters in one run."""
        option = self.cause.option
        of_first = option.terms.columns.shape[2]  # what other runs have of their own comes after
        place = option.take - of_first * (run if option.effect.own_per_run else 0)
        values = {
            option.terms.names[i]: float(value)
            for i, value in zip(place, self.value, strict=True)
            if 0 <= i < of_first
        }
        return AppliedEffect(option.effect, {**option.shape, **values})


def fitted_causes(findings: Findings) -> list[_Fitted]:
    """Fit all causes jointly and split the parameters up again."""
    if not findings.causes:
        return []
    fit = fit_jointly(findings.causes, findings.rows)
    u = np.sqrt(np.diag(fit.covariance))
    parts, start = [], 0
    for cause in findings.causes:
        stop = start + cause.option.take.size
        parts.append(_Fitted(cause, fit.value[start:stop], u[start:stop]))
        start = stop
    return parts


def _named_causes(findings: Findings) -> list[NamedCause]:
    gaps = [gap_um(s.rms_um, findings.simulated_um) for s in findings.steps]
    named: list[NamedCause] = []
    for k, part in enumerate(fitted_causes(findings)):
        option = part.cause.option
        units = dict(zip(option.terms.names, option.terms.units, strict=True))
        units |= dict(zip(option.effect.shape_names, option.effect.shape_units, strict=True))
        parameters = {**option.shape, **dict(zip(part.names, part.value.tolist(), strict=True))}
        cause = NamedCause(
            effect=option.effect.name,
            axes=part.axes,
            parameters=parameters,
            u=dict(zip(part.names, part.u.tolist(), strict=True)),
            units={n: units[n] for n in parameters},
            before_um=gaps[k],
            after_um=gaps[k + 1],
            shrink_percent=shrink_percent(gaps[k], gaps[k + 1]),
            confidence=part.cause.confidence,
            indistinguishable_from=part.cause.indistinguishable,
        )
        _add(named, cause)
    return named


def _add(named: list[NamedCause], cause: NamedCause) -> None:
    """Add a cause, or join it with one of the same effect on other axes."""
    for k, other in enumerate(named):
        if other.effect == cause.effect:
            suffix = '_' + '_'.join(cause.axes)
            renamed = {n: n if n not in other.parameters else n + suffix for n in cause.parameters}
            named[k] = replace(
                other,
                axes=(*other.axes, *cause.axes),
                parameters={
                    **other.parameters,
                    **{renamed[n]: v for n, v in cause.parameters.items()},
                },
                u={**other.u, **{renamed[n]: v for n, v in cause.u.items()}},
                units={**other.units, **{renamed[n]: v for n, v in cause.units.items()}},
                after_um=cause.after_um,
                shrink_percent=shrink_percent(other.before_um, cause.after_um),
            )
            return
    named.append(cause)


def _noise_cause(noise: NoiseFinding, before_um: float, after_um: float) -> NamedCause:
    effect = REGISTRY['tracker_noise']
    units = dict(zip(effect.shape_names, effect.shape_units, strict=True))
    return NamedCause(
        effect='tracker_noise',
        axes=(),
        parameters=noise.parameters,
        u={},
        units={n: units[n] for n in noise.parameters},
        before_um=before_um,
        after_um=after_um,
        shrink_percent=shrink_percent(before_um, after_um),
        confidence=noise.confidence,
        indistinguishable_from=(),
    )


_SENTENCES = {
    'none': 'No gap: the run looks like its simulation within the noise.',
    'explained': 'The gap of {before:.2f} um is explained by {causes}; {after:.2f} um remain.',
    'partly_explained': 'The gap of {before:.2f} um is partly explained by {causes}; '
    '{after:.2f} um remain unexplained.',
    'unknown': 'There is a gap of {before:.2f} um that no effect of the catalogue explains.',
}


def _spoken(causes: Sequence[NamedCause]) -> str:
    parts = []
    for cause in causes:
        text = cause.effect.replace('_', ' ')
        if cause.axes:
            text += f' ({", ".join(cause.axes)})'
        if cause.indistinguishable_from:
            others = ' or '.join(n.replace('_', ' ') for n in cause.indistinguishable_from)
            text += f', not told from {others}'
        parts.append(text)
    return ' and '.join(parts)


def _gap(findings: Findings, simulated_after_um: float) -> Gap:
    before, after = findings.steps[0], findings.steps[-1]
    before_um = gap_um(before.rms_um, findings.simulated_um)
    after_um = gap_um(after.rms_um, simulated_after_um)
    return Gap(
        measured_um=before.rms_um,
        simulated_um=findings.simulated_um,
        before_um=before_um,
        after_um=after_um,
        shrink_percent=shrink_percent(before_um, after_um),
        shrink_interval_percent=shrink_interval(before, after, simulated_after_um),
    )


def _without_unknown(findings: Findings, verdict: str) -> Findings:
    """Nothing is named where nothing explains the gap."""
    if verdict != 'unknown':
        return findings
    first = findings.steps[0]
    return replace(findings, causes=(), steps=(first,), fitted=first)


def answer(
    names: Sequence[str], findings: Findings, noise: NoiseFinding | None
) -> tuple[Diagnosis, Findings]:
    """Put findings into an answer; ``where`` is left empty.

    Parameters
    ----------
    names : sequence of str
        Of the runs.
    findings : Findings
    noise : NoiseFinding, optional
        Noise other than specified.

    Returns
    -------
    diagnosis : Diagnosis
    findings : Findings
        Less causes that explain too little to be named.
    """
    scale = float(np.sqrt(noise.variance_ratio)) if noise is not None else 1.0
    simulated_after = findings.simulated_um * scale
    judged = replace(findings, simulated_um=simulated_after) if noise else findings
    verdict = verdict_of(judged)
    findings = _without_unknown(findings, verdict)
    causes = _named_causes(findings)
    gap = _gap(findings, simulated_after)
    if noise is not None and verdict != 'unknown':
        last = gap_um(findings.steps[-1].rms_um, findings.simulated_um)
        causes.append(_noise_cause(noise, last, gap.after_um))
        verdict = 'explained' if verdict == 'none' else verdict
    causes.sort(key=lambda c: c.after_um - c.before_um if c.effect != 'tracker_noise' else 0.0)
    sentence = _SENTENCES[verdict].format(
        before=gap.before_um, after=gap.after_um, causes=_spoken(causes)
    )
    if noise is not None:
        sentence += f' Tracker noise: {noise.words}.'
    named = {c.effect for c in causes} | {n for c in causes for n in c.indistinguishable_from}
    hidden = [n for n, v in findings.visible.items() if not v.visible and n not in named]
    diagnosis = Diagnosis(
        runs=tuple(names),
        verdict=verdict,
        sentence=sentence,
        gap=gap,
        causes=tuple(causes),
        unexplained_um=gap.after_um,
        unexplained_where='',
        not_visible=tuple((n, REGISTRY[n].needs) for n in hidden),
        where=Where(),
        considered=findings.considered,
        extra={
            'smallest_found_um': {
                n: 1e6 * v.smallest for n, v in findings.visible.items() if np.isfinite(v.smallest)
            }
        },
    )
    return diagnosis, findings


def run_views(names: Sequence[str], findings: Findings) -> tuple[RunView, ...]:
    """Plain arrays of every run for figures and words."""
    rows, views = findings.rows, []
    before, after = rows.by_run(findings.steps[0].rows), rows.by_run(findings.fitted.rows)
    for name, run, solved, state, first, last in zip(
        names, rows.runs, rows.done.runs, rows.states, before, after, strict=True
    ):
        views.append(
            RunView(
                name=name,
                time=run.pieces.time,
                leg=run.pieces.leg,
                q=state.q,
                direction=state.direction,
                speed=state.speed,
                beam=state.beam,
                axes=solved.system.axes,
                residual_before=first,
                residual_after=last,
                expected=solved.whitener.expected,
                factors=solved.whitener.factors,
            )
        )
    return tuple(views)

# SPDX-License-Identifier: Apache-2.0
"""Sizes of the gap: of the runs, of their simulation, and of noise other than specified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.special import ndtr

from otf_core.arrays import Array
from otf_core.diagnosis.engine.evidence import estimate, estimate_of, products_of
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import Cause, displacement_of
from otf_core.effects import REGISTRY, Effect
from otf_core.effects.catalogue.tracker import tracker_noise
from otf_core.noise.departure import Departure, noise_departure, simulated_noise
from otf_core.noise.noise_model import QUANTITIES, NoiseModel, sample_variance
from otf_core.noise.standstill import find_standstills, standstill_noise
from otf_core.pieces.runs import Recording, Run
from otf_core.solving.residuals import FOLDS, leg_numbers
from otf_core.solving.whitener import Whitener

JACKKNIFE = 20
"""Groups of legs."""
SIMULATED_U = 0.04
"""Relative standard uncertainty of the simulated residual: how fast noise averages out."""


@dataclass(frozen=True)
class Residuals:
    """Squared residual of every piece.

    Attributes
    ----------
    square : ndarray, shape (p,), m^2
    leg : ndarray of int, shape (p,)
        Legs of all runs, numbered through.
    rows : ndarray, shape (r,), m
        Residuals of the rows they come from.
    """

    square: Array
    leg: NDArray[np.int64]
    rows: Array

    @property
    def rms_um(self) -> float:
        """Root mean square over the pieces, um."""
        return float(1e6 * np.sqrt(self.square.mean()))


def _per_piece(rows: Rows, values: Array) -> Residuals:
    square = [np.sum(part**2, axis=0) for part in rows.by_run(values)]
    return Residuals(np.concatenate(square), np.concatenate(leg_numbers(rows.done)), values)


def plain_residuals(rows: Rows) -> Residuals:
    """Residuals that the calibration leaves."""
    return _per_piece(rows, rows.left(rows.plain_deviation))


def residuals_with(rows: Rows, causes: Sequence[Cause], *, held_out: bool = True) -> Residuals:
    """Residuals once causes are added.

    Parameters
    ----------
    held_out : bool
        Each leg is judged with coefficients fitted without the legs of its fold; tables and
        poses are fitted to all legs.
    """
    if not causes:
        return plain_residuals(rows)
    options = [c.option for c in causes]
    size = np.concatenate([o.size for o in options])
    width = np.concatenate([o.widths for o in options])
    judged = [k for k in range(FOLDS) if (rows.fold == k).any()] if held_out else [-1]
    masks = [rows.fold == k for k in judged] if held_out else [slice(None)]
    products = [products_of(options, rows.residual, mask) for mask in masks]
    normal, right = (np.stack(part) for part in zip(*products, strict=True))
    if held_out:  # all legs less those of the fold
        normal, right = normal.sum(axis=0) - normal, right.sum(axis=0) - right
    fits = [estimate_of(n, r, size, width).value for n, r in zip(normal, right, strict=True)]
    moved = displacement_of(causes, np.stack(fits, axis=1))
    residual = rows.left(rows.plain_deviation[:, None] - moved)
    values = np.zeros(len(rows.deviation))
    for column, mask in zip(residual.T, masks, strict=True):
        values[mask] = column[mask]
    return _per_piece(rows, values)


def wave_um(cause: Cause, rows: Rows) -> float:
    """Root mean square displacement by a wave where it acts, um; 0 of others.

    Means over pieces wash waves out, and tables hold part of them. The coefficients of those that
    pieces wash out are amplitudes of sine and cosine.
    """
    option = cause.option
    effect = option.effect
    if option.terms.orders or not (effect.wave or effect.held_by_tables):
        return 0.0
    value = estimate(option.own, option.size, rows.residual, option.widths).value
    if effect.wave:
        return float(1e6 * np.sqrt(0.5 * np.sum(value**2)))
    moved = [effect.terms(s, option.shape).columns[:, :, option.take] @ value for s in rows.states]
    square = np.concatenate([np.sum(m**2, axis=1) for m in moved])
    acts = square > 0.0
    return float(1e6 * np.sqrt(np.mean(square[acts]))) if acts.any() else 0.0


def gap_um(measured_um: float, simulated_um: float) -> float:
    """Gap between a measured and a simulated residual (docs/conventions.md, gap.json), um."""
    return float(np.sqrt(max(0.0, measured_um**2 - simulated_um**2)))


def shrink_percent(before_um: float, after_um: float) -> float:
    """Share of a gap that is gone, percent; 0 where there was none."""
    return float(np.clip(100.0 * (1.0 - after_um / before_um), 0.0, 100.0)) if before_um else 0.0


def simulated_u(twin_um: float, simulated_um: float) -> float:
    """Standard uncertainty of a simulated residual, um.

    ``SIMULATED_U``; and where the level of the noise is that of what the causes leave, some of
    which may be no noise, it may lie anywhere between this and that of the standstills.
    """
    return float(np.hypot(SIMULATED_U * simulated_um, (simulated_um - twin_um) / np.sqrt(3.0)))


def shrink_interval(
    before: Residuals, after: Residuals, simulated_um: float, u_um: float
) -> tuple[float, float]:
    """95 % interval of the shrink.

    Scatter between groups of legs, left out in turn (jackknife), and the standard uncertainty
    ``u_um`` of the simulated residual.
    """
    group = before.leg % JACKKNIFE
    sums = [np.bincount(group, r.square, JACKKNIFE) for r in (before, after)]
    count = np.bincount(group, minlength=JACKKNIFE)

    def shrink(keep: NDArray[np.bool_], more_um: float = 0.0) -> float:
        sizes = (1e6 * np.sqrt(s[keep].sum() / count[keep].sum()) for s in sums)
        noise = max(0.0, simulated_um + more_um)
        return shrink_percent(*(gap_um(float(x), noise) for x in sizes))

    used = np.flatnonzero(count)
    if len(used) < 2:
        return 0.0, 100.0
    whole = shrink(count > 0)
    shrinks = np.array([shrink((count > 0) & (np.arange(JACKKNIFE) != k)) for k in used])
    u = float(np.sqrt((len(used) - 1) / len(used) * np.sum((shrinks - shrinks.mean()) ** 2)))
    levels = [shrink(count > 0, k * u_um) - whole for k in (-2.0, 2.0)]
    low = whole - float(np.hypot(2 * u, min(0.0, *levels)))
    high = whole + float(np.hypot(2 * u, max(0.0, *levels)))
    return max(0.0, low), min(100.0, high)


SLOW, CORRELATED = 'correlation_time', 'correlated over'
"""Slow noise as a parameter of the effect, and in words."""


@dataclass(frozen=True)
class NoiseFinding:
    """Noise other than specified.

    Attributes
    ----------
    parameters : dict
        Of the effect: what departs from the specification.
    confidence : float
        Probability of what departs most clearly; see ``noise.departure``.
    variance_ratio : float
        Mean variance of the rows with the measured levels over that with the specified ones.
    """

    parameters: dict[str, float]
    confidence: float
    variance_ratio: float
    words: str

    @property
    def level(self) -> float:
        """Mean standard deviation over the specified one."""
        return float(np.sqrt(self.variance_ratio))

    @property
    def effect(self) -> Effect:
        """The effect that stands for it."""
        return tracker_noise


def _parameters(seen: Departure) -> dict[str, float]:
    """Parameters of the effect that depart."""
    named = {}
    if seen.loud[0]:
        named['level_range'] = float(seen.level[0])
    if seen.loud[1:].any():  # the effect has one factor for both angles
        named['level_angle'] = float(np.sqrt(np.mean(seen.level[1:] ** 2)))
    if seen.slow:
        named[SLOW] = seen.time
    if seen.heavy:
        named['dof'] = seen.dof
    return named


def _words(seen: Departure) -> list[str]:
    parts = [
        f'noise of the {name} {level:.2f} times as specified (u {level * u:.2g})'
        for name, level, u, loud in zip(
            QUANTITIES, seen.level, seen.u_level, seen.loud, strict=True
        )
        if loud
    ]
    if seen.slow:
        parts.append(f'{CORRELATED} {seen.time:.1f} s (u {seen.time * seen.u_time:.2g} s)')
    if seen.heavy:
        parts.append(f"heavy tails (Student's t, {seen.dof:.1f} degrees of freedom)")
    return parts


def check_noise(
    rows: Rows, speed: float, exclude: Sequence[str] = (), *, gap: bool = True
) -> NoiseFinding | None:
    """Compare the noise in standstills with machine.yaml; None if it is as specified.

    Without a ``gap``, and where it is not clearly louder than specified, only slow noise is looked
    for: the simulation has the colour of the run's own standstills, so slow noise makes no gap.
    Tails are of no consequence then.
    """
    if tracker_noise.name in exclude or tracker_noise.name not in REGISTRY:
        return None
    departures: dict[str, tuple[float, float]] = {}
    words: list[str] = []
    for run in _runs(rows):
        seen = noise_departure(run.recording.samples, run.machine.tracker, speed)
        if seen is None:
            continue
        all_told = gap or bool(np.any(seen.louder))
        for name, value in _parameters(seen).items():
            probability = seen.probability(name)
            if (all_told or name == SLOW) and probability > departures.get(name, (0.0, 0.0))[1]:
                departures[name] = (value, probability)
        words += [w for w in _words(seen) if all_told or w.startswith(CORRELATED)]
    if not departures:
        return None
    return NoiseFinding(
        {name: value for name, (value, _) in departures.items()},
        max(probability for _, probability in departures.values()),
        _variance_ratio(rows),
        '; '.join(dict.fromkeys(words)),
    )


def with_measured_noise(run: Run, speed: float) -> Run:
    """Return a run with the noise of its standstills where that is clearly louder than specified.

    Up to ``noise.departure.MAX_LEVEL_RATIO`` it passes as specified, and a solution takes it as
    specified; but what is left of a gap has to be compared with the noise that was there.
    """
    return replace(run, noise=replace_louder(run.noise, run.recording, speed))


def replace_louder(noise: NoiseModel, recording: Recording, speed: float) -> NoiseModel:
    """Take the noise of the standstills for those components in which it is clearly louder."""
    samples, spec = recording.samples, recording.machine.tracker
    seen = noise_departure(samples, spec, speed)
    measured = standstill_noise(samples, find_standstills(samples, speed))
    if seen is None or measured is None:
        return noise
    parts = zip(noise, measured.noise, seen.louder, strict=True)
    return NoiseModel(*(own if loud else old for old, own, loud in parts))


def _runs(rows: Rows) -> Sequence[Run]:
    """Runs of recordings with their standstills, of linear axes or with rotary ones."""
    return cast(Sequence[Run], rows.observed)


def _variance_ratio(rows: Rows) -> float:
    measured, specified = 0.0, 0.0
    for run, solved in zip(_runs(rows), rows.done.runs, strict=True):
        shares = solved.system.shares
        measured += float(sample_variance(run.noise, shares).sum())
        spec = simulated_noise(run.noise, run.machine.tracker)
        specified += float(sample_variance(spec, shares).sum())
    return measured / specified


def simulated_um(rows: Rows) -> float:
    """Expected residual that tables and poses leave of the noise of the simulation alone, um.

    With A the rows of a run, S the covariance of the noise, R what is known before the data and
    N = A'S^-1 A + R, the variances of what is left (``Rows.left``) are the diagonal of

        S - A (N^-1 + N^-1 R N^-1) A'

    What is louder than may pass as specified is simulated as specified, so that it is a gap.
    """
    systems = [s.system for s in rows.done.runs]
    whiteners = tuple(
        Whitener.of(system, run.pieces, simulated_noise(run.noise, run.machine.tracker))
        for system, run in zip(systems, rows.observed, strict=True)
    )
    rows = replace(rows, whiteners=whiteners)
    inverse = linalg.cho_solve((rows.factor, True), np.eye(len(rows.use)))
    scale = rows.done.unknowns.gauge[:, rows.use] * rows.limit
    followed = scale @ (inverse + inverse @ rows.ridge @ inverse) @ scale.T
    square, pieces = 0.0, 0
    for whitener, system in zip(rows.whiteners, systems, strict=True):
        own = system.rows.dense(slice(None))
        square += float(np.sum(whitener.expected**2)) - float(np.sum(own * (own @ followed)))
        pieces += own.shape[1]
    return float(1e6 * np.sqrt(square / pieces))


def chance_of_misfit(measured_um: float, simulated_um: float, u_um: float, rows: int) -> float:
    """Probability of a residual this large if the simulation were complete.

    The logarithm of the residual over that of the simulation is taken as normal; its variance is
    that of the simulated one and of the mean square of so many rows, 1/(2 n).
    """
    ratio = np.log(measured_um / simulated_um)
    return float(ndtr(-ratio / np.hypot(u_um / simulated_um, 1.0 / np.sqrt(2.0 * rows))))

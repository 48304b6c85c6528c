# SPDX-License-Identifier: Apache-2.0
"""Rows to diagnose: with which functions of the motions, and with which noise.

Whether short waves along an axis are the machine's own, or an effect.

Where neighbouring pieces differ by more than the noise, a calibration tries functions twice as
fine (``solving.model_choice``). These follow whatever lies at fixed places of an axis: what the
tables cannot follow between their nodes, a cyclic error with a period of some intervals. What
they follow leaves no trace, and a diagnosis would find nothing. So both are weighed as
explanations of the same pieces,

    log K = log p(y | ordinary functions, effects at fixed places) - log p(y | fine functions),

with all coefficients integrated out, those of the functions with their roughness, and the noise
as measured. The diagnosis starts from the likelier of both.

A strong effect also misleads the choice between smooth functions and straight lines between nodes:
what it leaves drowns the kinks of the tables, and once it is found, these look like waves between
nodes. So where both are found, the choice is made again beside the effect.

Noise of the tracker, where a vibration shakes the target in its standstills as well.

Levels and colour of the noise are those of the standstills of a run. What swings there looks like
louder noise that is gone after a fraction of its period: the slow part of the noise is then taken
for a gap, and the tracker for louder than specified. So once a steady vibration is found, it is
taken off the samples, and the noise is measured again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from otf_core.arrays import Array
from otf_core.aside import share_out
from otf_core.calibration.calibrate import SolvedRecordings
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.effect_products import Candidates, tried_shapes
from otf_core.diagnosis.engine.evidence import (
    TOGETHER,
    Option,
    likeliest_width,
    motions_of,
    products_of,
)
from otf_core.diagnosis.engine.gap_sizes import with_measured_noise
from otf_core.diagnosis.engine.residual_rows import NOISE_RANGE, Rows, build_rows, rows_of
from otf_core.diagnosis.engine.search import (
    Cause,
    displacement_of,
    effects_without,
    fit_jointly,
    places_of,
    search,
    search_beside,
    shapes_from_lines,
    spectral_lines,
    tried_effects,
)
from otf_core.effects import AppliedEffect, BelongsTo, Effect
from otf_core.effects.free_form import FreeForm
from otf_core.effects.state import state_of_travel
from otf_core.errors import InputError
from otf_core.live.stages import silent
from otf_core.model.observation import Samples
from otf_core.noise.noise_model import NoiseModel
from otf_core.noise.standstill import (
    MIN_TOTAL,
    find_standstills,
    level_scatter,
    noise_model,
    standstill_noise,
)
from otf_core.pieces.runs import Recording, Run
from otf_core.solving.joint import (
    JointSolution,
    SolvedRun,
    Start,
    solve_jointly,
    sum_normal_equations,
    unknowns_of,
)
from otf_core.solving.model_choice import is_finer
from otf_core.solving.roughness import Search
from otf_core.solving.unknowns import Basis, linear_bases, smooth_bases
from otf_core.solving.whitener import Whitener

CLEAR = 50.0
"""Logarithm of the odds by which an effect has to be better than fine functions: the roughness of
18 motions is fitted on both sides, which is worth some ten."""
HELD = 2.5
"""Intervals of cubic splines in a wave that they follow nearly whole."""
NOT_FOLLOWED = 0.05
"""Share of what fine functions gain that waves in a few motions need not explain: they may have
other forms than the parabolas of the effect. The machine's own waves are in all its motions."""


def rows_to_diagnose(
    runs: Sequence[Run],
    joint: JointSolution,
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    exclude: Sequence[str],
) -> Rows:
    """Set up the rows of a diagnosis, with functions that do not follow an effect.

    Parameters
    ----------
    joint : JointSolution
        Of the calibration, without reversal.
    nodes : mapping of axis to ndarray, m
        Of the tables that machine.yaml asks for.
    exclude : sequence of str
        Effects taken out of the catalogue.
    """
    limit = config.unidentifiable_above
    loud = [with_measured_noise(run, config.standstill_speed) for run in runs]
    rows = build_rows(loud, joint, limit)
    effects = _at_places(exclude)
    if not is_finer(joint.unknowns.bases) or not effects:
        return rows
    machine = runs[0].machine
    both = (linear_bases(machine, nodes), smooth_bases(machine, nodes))
    solved = share_out(lambda bases: _solved(runs, joint, bases, config), both, (runs, joint))
    others = [build_rows(loud, one, limit) for one in solved if one is not None]
    fine, *alone = share_out(_likelihood, [rows, *others])
    for other, own in sorted(zip(others, alone, strict=True), key=lambda pair: -pair[1]):
        if _likelier(other, own, fine, effects):
            return other
    return rows


def _likelier(rows: Rows, alone: float, fine: float, effects: Sequence[Effect]) -> bool:
    """Return whether effects at places are likelier than fine functions; see ``_likelihood``."""
    causes = search(rows, _candidates(rows, effects))[0]
    allowed = NOT_FOLLOWED * (fine - alone) if _in_few_motions(causes) else 0.0
    return _likelihood(rows, causes) + max(allowed, 0.0) > fine + CLEAR


def straight_rows(
    rows: Rows,
    causes: Sequence[Cause],
    joint: JointSolution,
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    exclude: Sequence[str],
) -> Rows | None:
    """Rows with straight lines between nodes, where causes found had hidden that they are right.

    Parameters
    ----------
    rows : Rows
        With smooth functions; None is returned for others.
    causes : sequence of Cause
        Found in them; None is returned where waves between nodes are not among several.
    done, nodes, config, exclude
        As of ``rows_to_diagnose``.
    """
    bases = rows.done.unknowns.bases
    smooth = all(b.degree > 1 for b in bases.values()) and not is_finer(bases)
    waves = any(c.option.effect.belongs_to is BelongsTo.TABLES for c in causes)
    known = [c for c in causes if not _stays_at_places(c.option.effect)]
    if not (smooth and waves and known):
        return None
    solved = _solved(rows.runs, joint, linear_bases(rows.runs[0].machine, nodes), config)
    if solved is None:
        return None
    straight = build_rows(rows.runs, solved, config.unidentifiable_above)
    candidates = _candidates(straight, _at_places(exclude))
    beside = search_beside(straight, candidates, [_again(cause, straight) for cause in known])
    better = _likelihood(straight, beside) > _likelihood(rows, causes) + CLEAR
    return straight if better else None


def _again(cause: Cause, rows: Rows) -> Cause:
    """The same cause in other rows."""
    option = cause.option
    (tried,) = tried_shapes(rows, option.effect, [option.shape])
    return replace(cause, option=tried.made(option.take, 1.0))


def _at_places(exclude: Sequence[str]) -> list[Effect]:
    """Effects that stay at fixed places, less those excluded."""
    return [e for e in effects_without(exclude) if _stays_at_places(e)]


def _stays_at_places(effect: Effect) -> bool:
    """Return whether fine functions of the positions of axes can follow an effect."""
    cyclic = effect.wave is not None and not effect.wave.in_time
    return cyclic or effect.belongs_to is BelongsTo.TABLES


def held_by(option: Option, bases: dict[str, Basis]) -> bool:
    """Return whether the fine functions of a calibration hold a wave that is an effect."""
    wave = option.effect.wave
    if wave is None or wave.in_time or not is_finer(bases):
        return False
    step = max(float(np.diff(basis.knots).max(initial=0.0)) for basis in bases.values())
    return option.shape[wave.parameter] > HELD * step


def _in_few_motions(causes: Sequence[Cause]) -> bool:
    """Return whether something is found, and that in a few motions alone."""
    many = [motions_of(c.option) for c in causes if c.option.effect.many_alike]
    return bool(causes) and all(len(motions) <= TOGETHER for motions in many)


def _solved(
    runs: Sequence[Run], joint: JointSolution, bases: dict[str, Basis], config: CalibrationConfig
) -> JointSolution | None:
    """Solve the same pieces, with the same noise, for other functions; None if none settles."""
    unknowns = unknowns_of(runs, bases)
    start = Start.after(runs[0].machine, joint)
    try:
        return solve_jointly(runs, unknowns, config, silent, start)
    except InputError:  # the calibration itself has settled; this is only its rival
        return None


def _likelihood(rows: Rows, causes: Sequence[Cause] = ()) -> float:
    """Logarithm of the likelihood of runs with causes, their noise as measured.

    That of the runs less the causes as fitted, the roughness of the functions found anew, times
    the share of what was possible before the data that they leave of the coefficients.
    """
    joint = rows.done
    systems, price = [s.system for s in joint.runs], 0.0
    if causes:
        fitted = fit_jointly(causes, rows).value
        moved = displacement_of(causes, fitted)
        parts = zip(systems, rows.by_run(moved), strict=True)
        systems = [replace(s, deviation=s.deviation - part) for s, part in parts]
        price = _price(causes, fitted, rows.residual)
    normal = sum_normal_equations(systems, joint.unknowns, rows.whiteners)
    search = Search(normal, joint.unknowns, _blocks(rows), rows.limit)
    return search.run().log_likelihood - price


def _blocks(rows: Rows) -> list[str]:
    """Blocks of ``Rows.use``: what is solved for, and rotations that still leave a trace."""
    blocks = rows.done.unknowns.free_blocks.items()
    places = {name: np.arange(block.start, block.stop) for name, block in blocks}
    return [n for n, own in places.items() if own.size and np.isin(own, rows.use).all()]


def _price(causes: Sequence[Cause], fitted: Array, residual: Array) -> float:
    """1/2 c' D^-2 c + 1/2 log det (I + M) for coefficients c, see ``evidence``."""
    options = [c.option for c in causes]
    width = np.concatenate([o.width if len(o.width) else _width(o, residual) for o in options])
    unit = width / np.concatenate([o.size for o in options])
    normal = products_of(options, residual)[0] * np.outer(unit, unit)
    _, volume = np.linalg.slogdet(np.eye(len(unit)) + normal)
    return 0.5 * float(np.sum((fitted / unit) ** 2) + volume)


def _width(option: Option, residual: Array) -> Array:
    """Standard deviation of the displacement by each coefficient that is most likely, m."""
    return likeliest_width(
        *products_of([option], residual), option.size, 1.0, np.zeros(len(option.take))
    )


def _candidates(rows: Rows, effects: Sequence[Effect]) -> Candidates:
    """What some effects may be."""
    return tried_effects(rows, effects, shapes_from_lines(spectral_lines(rows)))[0]


SHORTEST = 1e-3
"""s; a shorter correlation time is none."""
OTHER_LEVEL, OTHER_TIME = 1.1, 1.5
"""Factors on level and correlation time from which on noise is another one."""


def remove_steady_vibration(
    rows: Rows, causes: Sequence[Cause], config: CalibrationConfig
) -> Rows | None:
    """Rows with the noise of standstills less the steady vibrations found; None if it is the same.

    The samples of their runs are without these vibrations, the pieces still hold them.
    """
    if not rows.runs or not any(_is_steady(c) for c in causes):
        return None
    value, places = fit_jointly(causes, rows).value, places_of(causes)
    pairs = zip(causes, places, strict=True)
    vibrations = [_applied(cause, value[own]) for cause, own in pairs if _is_steady(cause)]
    calm = [
        remeasure_noise(run, vibrations, solved.pose.rotation, config)
        for run, solved in zip(rows.runs, rows.done.runs, strict=True)
    ]
    if all(_same(one.noise, run.noise) for one, run in zip(calm, rows.runs, strict=True)):
        return None
    return build_rows(calm, rows.done, rows.limit)


def _is_steady(cause: Cause) -> bool:
    """Return whether a cause swings all the time: at rest as well."""
    effect = cause.option.effect
    return effect.wave is not None and effect.wave.in_time and not isinstance(effect, FreeForm)


def _applied(cause: Cause, value: Array) -> AppliedEffect:
    option = cause.option
    names = [option.terms.names[k] for k in option.take]
    parameters = dict(zip(names, value.tolist(), strict=True))
    return AppliedEffect(option.effect, {**option.shape, **parameters})


def remeasure_noise(
    run: Run, vibrations: Sequence[AppliedEffect], rotation: Array, config: CalibrationConfig
) -> Run:
    """Return a run with samples that do not swing, and the noise of their standstills.

    ``rotation`` turns tracker coordinates to those of the machine.
    """
    samples, speed = (
        _remove_swings(run.samples, run, vibrations, rotation),
        config.standstill_speed,
    )
    noise = noise_model(samples, run.machine.tracker, speed)
    return with_measured_noise(replace(run, samples=samples, noise=noise), speed)


def _remove_swings(
    samples: Samples, run: Run, effects: Sequence[AppliedEffect], rotation: Array
) -> Samples:
    """Samples less what swings."""
    nothing = np.zeros((len(samples), 3))
    state = state_of_travel(run.machine, nothing, nothing)
    state = replace(state, time=(samples.stamp_ns - samples.stamp_ns[0]) * 1e-9)
    moved = sum((one.effect.displacement(state, one.parameters) for one in effects), nothing)
    return replace(samples, xyz=samples.xyz - moved @ rotation)


def _same(one: NoiseModel, other: NoiseModel) -> bool:
    """Return whether two noises are alike."""
    pairs = list(zip(one, other, strict=True))
    levels = [abs(np.log(a.level / b.level)) for a, b in pairs]
    times = [_factor(a.correlation_time, b.correlation_time) for a, b in pairs]
    return bool(max(levels) < np.log(OTHER_LEVEL) and max(times) < np.log(OTHER_TIME))


def _factor(one: float, other: float) -> float:
    """Size of the logarithm of a ratio of times, either of which may be 0 for white noise."""
    return abs(float(np.log(max(one, SHORTEST) / max(other, SHORTEST))))


def rows_of_axes(found: SolvedRecordings, config: CalibrationConfig) -> Rows:
    """Rows of a machine with rotary axes: whitened for the noise of the standstills alone."""
    solved, speed = found.solution.joint.runs, config.rest_speed
    recordings = [run.recording for run in found.solution.runs]
    observed = [
        replace(one.run, noise=_floor(recording, speed, one), fitted=None)
        for recording, one in zip(recordings, solved, strict=True)
    ]
    rows = rows_of(observed, found.solution.joint, config.unidentifiable_above)
    return replace(rows, noise_range=_noise_range(recordings, speed))


def _noise_range(recordings: Sequence[Recording], speed: float) -> tuple[float, float]:
    """Variances over those of the standstills; the wider, the less standstill there is."""
    low, high = NOISE_RANGE
    for samples in (r.samples for r in recordings):
        still = float(np.diff(find_standstills(samples, speed), axis=1).sum()) * samples.step
        high = max(high, level_scatter(max(still, MIN_TOTAL)) ** 2)
    return low, high


def _floor(recording: Recording, speed: float, solved: SolvedRun) -> NoiseModel:
    """Noise that the simulation of a recording has.

    That of the standstills where they are louder than specified, however little; or less where all
    that the residuals hold is less: stops of a second tell the slow part to some ten percent only.
    """
    samples, spec = recording.samples, recording.machine.tracker
    runs = find_standstills(samples, speed)
    mean = float(np.mean(runs[:, 1] - runs[:, 0])) * samples.step if len(runs) else 0.0
    noise, measured = noise_model(samples, spec, speed), standstill_noise(samples, runs)
    if measured is not None:
        pairs = zip(noise, measured.noise, strict=True)
        noise = NoiseModel(*(max(pair, key=lambda c: c.level) for pair in pairs))
    fitted = solved.run.noise_and_misfit[0]
    noise = with_slow_part(noise, fitted, mean)
    expected = Whitener.of(solved.system, solved.run.pieces, noise).expected
    less = np.sum(solved.whitener.expected**2) < np.sum(expected**2)
    return at_most(noise, fitted) if less else noise


def with_slow_part(noise: NoiseModel, fitted: NoiseModel, length: float) -> NoiseModel:
    """Noise of standstills with the correlation time that they are too short to show.

    A stop hides correlation over more than its length (s): up to that, the time is the fitted
    one, which comes from pieces of lines that are longer than any stop.
    """
    pairs = zip(noise, fitted, strict=True)
    times = [(own, min(f.correlation_time, max(own.correlation_time, length))) for own, f in pairs]
    return NoiseModel(*(replace(own, correlation_time=time) for own, time in times))


def at_most(noise: NoiseModel, fitted: NoiseModel) -> NoiseModel:
    """Noise of standstills, with variances of fitted noise where these are smaller."""
    components = []
    for own, other in zip(noise, fitted, strict=True):
        white = min(own.white, other.white)
        level = float(np.hypot(white, min(own.slow, other.slow)))
        components.append(replace(own, level=level, white=white))
    return NoiseModel(*components)

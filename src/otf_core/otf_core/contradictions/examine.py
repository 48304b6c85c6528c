# SPDX-License-Identifier: Apache-2.0
"""Examination of runs that are aligned and reduced to pieces, most consequential checks first.

First what can be repaired (offsets of segments, steps of the tracker), then what the repaired runs
contradict: each other, the chain, the noise, the range.

*Chain.* A rotation acts through the travels of the axes beyond it. Its own travel acts like a
translation of the same axis, so the place of the base b in the chain changes what is called
straightness and positioning, never what fits: the data show the order of the axes from workpiece
to tool, six classes of four chains each.

*Target offset.* With one offset a wrong one cannot be seen: rotations times a constant lever are
translations of the same axis, and what is predicted at that target stays right. Between runs the
difference of the offsets counts: with a wrong one they do not fit together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.contradictions.beam_breaks import settle_offsets
from otf_core.contradictions.quick_model import Model
from otf_core.contradictions.tracker_moves import settle_steps
from otf_core.errors import InputError
from otf_core.model.machine import Chain
from otf_core.model.observation import Samples
from otf_core.noise.standstill import find_standstills, standstill_noise
from otf_core.pieces.finding import GATE, WARNING, Finding
from otf_core.pieces.runs import Run

MAX_RATIO = 1.3
"""Residual over noise from which on other chains are tried."""
MAX_SHARE = 0.7
"""Residual of another order, over that of the stated one, that contradicts it."""
EQUAL_FIT = 1.15
"""Residuals over the best that fit as well."""


def chains_of(order: tuple[str, ...]) -> tuple[str, ...]:
    """The four chains of one order."""
    return tuple(str(Chain(order[:k], order[k:])) for k in range(len(order) + 1))


def check_chain(model: Model) -> list[Finding]:
    """Try all orders of axes where the stated chain fits badly."""
    if model.fit.ratio < MAX_RATIO:
        return []
    chain, residual = model.rows.machine.chain, model.left_by_order
    stated = (*chain.table_side, *chain.target_side)
    best = min(residual.values())
    if best > MAX_SHARE * residual[stated]:
        return []
    fits = sorted(
        (o for o in residual if residual[o] < EQUAL_FIT * best), key=lambda o: residual[o]
    )
    named = '; or '.join(
        f'{" ".join(o)} ({1e6 * residual[o]:.2f} um: {", ".join(chains_of(o))})' for o in fits
    )
    return [Finding('chain', GATE, (
        f'{model.rows.machine.chain} leaves {1e6 * residual[stated]:.2f} um; other orders of axes '
        f'from workpiece to tool leave less: {named}. The position of b cannot be '
        f'determined from the data; correct the chain in machine.yaml'
    ))]  # fmt: skip


MIN_DRIVEN_SHARE = 0.8
"""Share of the range of an axis that is to be driven."""


def check_driven_range(runs: Sequence[Run]) -> list[Finding]:
    """State which axes were driven over a part of their range only."""
    machine, short = runs[0].machine, []
    for k, (name, axis) in enumerate(machine.axes.items()):
        q = np.concatenate([run.pieces.q[:, k] for run in runs])
        low, high, size = float(q.min()), float(q.max()), axis.max - axis.min
        if high - low >= MIN_DRIVEN_SHARE * size:
            continue
        scale, unit = (np.degrees(1.0), 'deg') if axis.rotary else (1e3, 'mm')
        short.append(
            f'{name} over {scale * (high - low):.0f} of {scale * size:.0f} {unit} '
            f'({100 * (high - low) / size:.0f} %, {scale * low:.0f} to {scale * high:.0f} {unit})'
        )
    if not short:
        return []
    parts = ', '.join(short)
    return [Finding('driven range', WARNING, (
        f'only part of the range was driven: {parts}; the tables end there, and beyond them '
        f'nothing is known: drive the whole range, or state the range in use in machine.yaml'
    ))]  # fmt: skip


WARNING_RATIO = 1.3
"""Residual together over alone from which on a warning is given."""
GATE_RATIO = 2.0
"""The same, for a gate."""
WARNING_DIFFERENCE, CHANGED_DIFFERENCE, OTHER_MACHINE_DIFFERENCE = 0.05, 0.1, 0.3
"""Part of the errors by which runs differ: for a warning; for a changed machine; for
another machine."""
MIN_OFFSET_DIFFERENCE = 1e-4
"""m; target offsets that differ by more: a wrong one makes runs that do not fit together."""


def check_one_machine(model: Model, alone: Sequence[Model]) -> list[Finding]:
    """Compare the fit of all runs with that of each alone.

    Parameters
    ----------
    alone : sequence of Model
        Of every recording by itself.

    Raises
    ------
    InputError
        If they are clearly of different machines.
    """
    if len(alone) < 2:
        return []
    together = model.fit.ratio
    apart = _joined([m.fit.square for m in alone], [m.fit.freedom for m in alone])
    if together < WARNING_RATIO * apart:
        return []
    unit = model.fit.rms / together
    extra = unit * np.sqrt(together**2 - apart**2)
    share = extra / max(_errors(model), 1e-12)
    if share < WARNING_DIFFERENCE:
        return []
    which = _outsider(alone) if len(alone) > 2 else ''
    text = (
        f'each run alone fits to {1e6 * unit * apart:.2f} um, together they fit to '
        f'{1e6 * unit * together:.2f} um{which}'
    )
    if share > OTHER_MACHINE_DIFFERENCE and together > GATE_RATIO * apart:
        raise InputError(
            f'{_names(model.runs)}: {text}: they are not of one machine, or the machine was '
            f'changed between them (readjusted, crashed, referenced again); calibrate them '
            f'separately'
        )
    offsets = np.array([run.machine.target_offset for run in model.runs])
    differ = bool(np.ptp(offsets, axis=0).max() > MIN_OFFSET_DIFFERENCE)
    grave = (differ or share > CHANGED_DIFFERENCE) and together > GATE_RATIO * apart
    return [Finding('one machine', GATE if grave else WARNING, (
        f'{text}: the machine changed between the runs (temperature, load, readjustment), a '
        f'target_offset differs from the stated one, e.g. in its sign, or an effect is missing in '
        f'the model; correct the offset, or calibrate the runs separately and compare'
    ))]  # fmt: skip


def _joined(square: Sequence[float], freedom: Sequence[float]) -> float:
    return float(np.sqrt(sum(square) / max(sum(freedom), 1.0)))


def _errors(model: Model) -> float:
    """What the tables explain, m: weighted like the residual of a row."""
    fit, rows = model.fit, model.rows
    posed = fit.design.usual[:, : 6 * rows.runs]
    whole = rows.deviation.ravel()
    value = np.linalg.lstsq(
        posed * np.sqrt(fit.weight)[:, None],
        whole * np.sqrt(fit.weight),
        rcond=None,
    )[0]
    residual = whole - posed @ value
    return float(np.sqrt(fit.weight @ residual**2 / fit.weight.sum()))


def _outsider(alone: Sequence[Model]) -> str:
    """Name the run without which the others fit, if there is one."""
    best, name = np.inf, ''
    for k, one in enumerate(alone):
        others = [m for n, m in enumerate(alone) if n != k]
        apart = _joined([m.fit.square for m in others], [m.fit.freedom for m in others])
        ratio = Model.of([r for m in others for r in m.runs]).fit.ratio / apart
        if ratio < best:
            best, name = ratio, one.runs[0].recording.name or f'run {k + 1}'
    return f' (without {name} the others fit)' if best < WARNING_RATIO else ''


def _names(runs: Sequence[Run]) -> str:
    return ', '.join(r.recording.name or f'run {k}' for k, r in enumerate(runs, start=1))


MAX_NOISE_RATIO, MIN_NOISE_RATIO = 5.0, 1.0 / 15.0
"""Measured over specified noise that contradicts: trackers are often better than specified."""
OVERSTATED_NOISE_RATIO = 0.3
"""Residual over noise below which the noise is smaller than assumed."""
THIRD_DIFFERENCE_SIGMA = np.sqrt(20.0)
"""Standard deviation of the third difference of white noise of unit variance."""
NORMAL_MEDIAN = 0.6745
QUANTILES = (5.0, 85.0)
"""Percentiles of the third differences; corners spoil the uppermost."""
MIN_RATIO_OF_TWO_KINDS = 30.0
"""Their ratio from which on there are two kinds of samples; normal noise gives 4, Student's t of
three degrees of freedom 10."""
MAX_UNEVENNESS, MIN_DIFFERENCES = 0.25, 100
"""Share by which intervals of stamps may differ from the usual one for differences from sample to
sample to be taken; fewest of these, else all are."""
WARNING_OUTLIER_SHARE, GATE_OUTLIER_SHARE = 0.1, 0.3
"""Shares of outliers from which they are reported, and from which the quality gate fails."""


def measured_noise(samples: Samples, speed: float) -> tuple[Array, str]:
    """Level of range and two angles: at standstill, else from one sample to the next.

    Returns
    -------
    level : ndarray, shape (3,), m, rad, rad
    where : str
        In words.
    """
    measured = standstill_noise(samples, find_standstills(samples, speed))
    if measured is not None:
        return measured.noise.level, 'at standstill'
    third, middle = _third(samples)
    distance = np.linalg.norm(middle, axis=1)
    along = np.einsum('ij,ij->i', third, middle) / distance
    across = np.linalg.norm(np.cross(middle / distance[:, None], third), axis=1) / distance
    u_range = float(np.median(np.abs(along))) / NORMAL_MEDIAN / THIRD_DIFFERENCE_SIGMA
    u_angle = float(np.median(across)) / 1.1774 / THIRD_DIFFERENCE_SIGMA
    return np.array([u_range, u_angle, u_angle]), 'from sample to sample'


def _third(samples: Samples) -> tuple[Array, Array]:
    """Third differences (m, 3) of samples that follow each other evenly, and their samples, m."""
    third, middle = np.diff(samples.xyz, 3, axis=0), samples.xyz[1:-2]
    step = np.diff(samples.stamp_ns)
    usual = float(np.median(step))
    even = np.abs(step - usual) <= MAX_UNEVENNESS * usual
    even = even[:-2] & even[1:-1] & even[2:]
    return (third[even], middle[even]) if even.sum() >= MIN_DIFFERENCES else (third, middle)


def outlying(samples: Samples) -> tuple[float, float]:
    """Share of samples that stand out from noise, and by how much.

    Third differences of noise of one level scatter little; a bad sample spoils four of them.

    Returns
    -------
    share : float
        Zero where they look like noise of one level.
    size : float
        m; median length of what stands out.
    """
    third = np.linalg.norm(_third(samples)[0], axis=1) / THIRD_DIFFERENCE_SIGMA
    low, high = np.percentile(third, QUANTILES)
    if low == 0.0 or high < MIN_RATIO_OF_TWO_KINDS * low:  # zero: rounded coordinates
        return 0.0, 0.0
    far = third > np.sqrt(low * high)
    share = 1.0 - (1.0 - float(np.mean(far))) ** 0.25
    return share, float(np.median(third[far]) * THIRD_DIFFERENCE_SIGMA / 3.0)


def check_noise_level(
    runs: Sequence[Run], ratio: float, config: CalibrationConfig
) -> list[Finding]:
    """Compare noise as measured and as specified, run by run; runs alike are reported once.

    Parameters
    ----------
    ratio : float
        Residual over noise.
    """
    findings = [f for run in runs if (f := _check(run, ratio, config)) is not None]
    return findings[:1]


def _check(run: Run, ratio: float, config: CalibrationConfig) -> Finding | None:
    spec = run.machine.tracker
    level, where = measured_noise(run.samples, run.speed_at_rest(config))
    ratios = level / np.array([spec.u_range, spec.u_angle, spec.u_angle])
    name = f'{run.name}: ' if run.name else ''
    above = max(ratios) > MAX_NOISE_RATIO
    share, size = outlying(run.samples) if above else (0.0, 0.0)
    if share > WARNING_OUTLIER_SHARE:
        return Finding('outliers', GATE if share > GATE_OUTLIER_SHARE else WARNING, (
            f'{name}about {100 * share:.0f} % of the samples are outliers of about '
            f'{1e6 * size:.2g} um; look for reflections, a dirty target or a disturbed beam, and '
            f'record again'
        ))  # fmt: skip
    if above:
        kind = 'larger'
    elif min(ratios) < MIN_NOISE_RATIO and ratio < OVERSTATED_NOISE_RATIO:
        kind = 'smaller'
    else:
        return None
    return Finding('noise', WARNING, (
        f'{name}noise measured {where} is {1e6 * level[0]:.3g} um along the beam, '
        f'{1e6 * level[1]:.3g} urad and {1e6 * level[2]:.3g} urad across, much {kind} than '
        f'u_range {1e6 * spec.u_range:.3g} um and u_angle {1e6 * spec.u_angle:.3g} urad '
        f'of machine.yaml; check the unit there (m and rad), and the tracker'
    ))  # fmt: skip


WARNING_LEFT_OUT = 0.01
"""Share of the samples from which what was left out as outliers is reported."""


def share_in_whole_pieces(run: Run, kept: Run) -> float:
    """Share of the samples that were left out as whole pieces of the path: no stray samples.

    Parameters
    ----------
    run, kept : Run
        With all pieces, and with those that were not far from the solution.
    """
    return 1.0 - kept.pieces.used / max(run.pieces.used, 1)


def check_left_out(run: Run, kept: Run) -> list[Finding]:
    """State how many samples of a run were left out as outliers, where they are many."""
    count = kept.pieces.outliers
    share = count / max(count + kept.pieces.used, 1)
    if share < WARNING_LEFT_OUT:
        return []
    name = f'{run.name}: ' if run.name else ''
    words = f'{name}{count} samples left out as outliers ({100 * share:.0f} %)'
    if share_in_whole_pieces(run, kept) > WARNING_LEFT_OUT:
        words += (
            ', in whole pieces of the path: real machine behaviour, or a beam that was disturbed '
            'for longer; ./otf diagnose includes all but the most distant in the gap'
        )
    return [Finding('left out', WARNING, words)]


MAX_RATIO_OF_STEPS = 1.1
"""Residual with steps, over that with offsets of segments, up to which steps are the answer."""


def examine(
    runs: Sequence[Run],
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    *,
    repair: bool = True,
) -> tuple[list[Run], tuple[Finding, ...]]:
    """Examine runs for contradictions, and repair what can be repaired.

    Runs on curves are examined for driven range and noise; what moved in them is found once they
    are solved, see ``part_steps``.

    Parameters
    ----------
    nodes : mapping of axis to ndarray, m
        Table nodes.
    repair : bool
        Take offsets off and cut runs at steps; else only report.

    Returns
    -------
    runs : list of Run
        Repaired; a run that was cut at a step is several.
    findings : tuple of Finding
        Of all runs.

    Raises
    ------
    InputError
        If the runs are of different machines.
    """
    alone: list[Model] = []
    findings: list[Finding] = []
    if any(run.shape is None for run in runs):
        findings += check_driven_range(runs)
        findings += check_noise_level(runs, np.inf, config)
        return list(runs), tuple(findings)
    for run in runs:
        model = Model.of([run])
        if not check_chain(model):  # its misfit is taken for a step otherwise
            model, findings = _repaired(model, findings, nodes, config, repair=repair)
        alone.append(model)
    whole = alone[0] if len(alone) == 1 else Model.of([r for m in alone for r in m.runs])
    findings += check_chain(whole) or check_one_machine(whole, alone)
    findings += check_driven_range(whole.runs)
    findings += check_noise_level(whole.runs, whole.fit.ratio, config)
    return list(whole.runs), tuple(findings)


def _repaired(
    model: Model,
    findings: list[Finding],
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    *,
    repair: bool,
) -> tuple[Model, list[Finding]]:
    """One run with offsets of segments and steps settled, and what was found so far.

    Steps between the breaks look like offsets of segments, and the other way round: the simpler
    answer holds where it leaves as little.
    """
    spacing = tuple(nodes[a] for a in model.rows.machine.axis_names)
    again, words = settle_offsets(model, repair=repair)
    if model.runs[0].pieces.standstill:
        return again, findings + words
    stepped, steps = settle_steps(model, spacing, config, repair=repair)
    if not words or (steps and stepped.fit.ratio < MAX_RATIO_OF_STEPS * again.fit.ratio):
        return stepped, findings + steps
    again, steps = settle_steps(again, spacing, config, repair=repair)
    return again, findings + words + steps

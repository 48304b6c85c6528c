# SPDX-License-Identifier: Apache-2.0
"""Shapes that a gap of unknown cause is compared with: step, drift, travel, feed, waves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.place.shapes import (
    GapShape,
    Maker,
    amplitude_words,
    direction_words,
    finer_shapes,
    one,
    wave,
)
from otf_core.diagnosis.place.views import RunView
from otf_core.model.path import TRAVELS

SETTLING = (-5, -4, -3, -2, -1)
"""Time constants of drifts: powers of two of the length of the run."""
MAX_STEPS = 60
"""Moments per run at which a step is looked for."""
SLOWEST_WAVE, FASTEST_WAVE = 1.5, 40.0
"""Waves in time: cycles per run."""
MOST_WAVES = 400
"""Lengths of waves looked for along an axis."""
WAVES_PER_AXIS = 3.0
"""Longer waves are for the tables."""
SHORTEST_WAVE = 2.2
"""Spacings of the pieces along the axis on the slowest lines."""
PER_FEED = 'um per 0.1 m/s'


def _in_run(views: Sequence[RunView], view: RunView) -> str:
    return f' in {view.name}' if len(views) > 1 else ''


def step_shapes(views: Sequence[RunView]) -> Iterator[GapShape]:
    """A step, at first between two legs."""

    def maker(run: RunView) -> Maker:
        def shape(start: float, width: float) -> GapShape:
            return GapShape(
                'step',
                lambda v: one((v.time >= start) & (v is run)),
                lambda c: (
                    f'since {start:.0f} s{_in_run(views, run)}, step of {direction_words(c)}'
                ),
                finer_shapes(shape, start, width),
            )

        return shape

    for view in views:
        starts = np.array([view.time[low] for low, _ in view.bounds])[2:-2]
        stride = max(1, -(-len(starts) // MAX_STEPS))
        width = stride * float(np.ptp(view.time)) / len(view.bounds)
        yield from (maker(view)(float(start), width) for start in starts[::stride])


def drift_shapes(views: Sequence[RunView]) -> Iterator[GapShape]:
    """A steady drift, and one that settles."""

    def steady(run: RunView) -> GapShape:
        def words(c: Array) -> str:
            return f'drift of {direction_words(c, 1e6, "um/min")}{_in_run(views, run)}'

        return GapShape('drift', lambda v: one(v.time / 60.0 * (v is run)), words)

    def settling(run: RunView) -> Maker:
        def shape(power: float, width: float) -> GapShape:
            tau = 2.0**power * float(np.ptp(run.time))

            def words(c: Array) -> str:
                return (
                    f'drift to {direction_words(c)} that settles with a time constant of about '
                    f'{tau:.2g} s{_in_run(views, run)}'
                )

            return GapShape(
                'drift',
                lambda v: one((1.0 - np.exp(-v.time / tau)) * (v is run)),
                words,
                finer_shapes(shape, power, width),
            )

        return shape

    for view in views:
        yield steady(view)
        yield from (settling(view)(float(p), 1.0) for p in SETTLING)


def _sense(view: RunView, axis: int) -> Array:
    d = view.direction[:, axis]
    return np.where(np.abs(d) < TRAVELS, 0.0, np.sign(d))


def travel_shapes(views: Sequence[RunView]) -> Iterator[GapShape]:
    """What flips with the sense of travel, alike at all feeds or growing with the feed."""
    speeds = np.concatenate([v.speed for v in views])
    axes, two_feeds = (
        views[0].axis_names,
        np.quantile(speeds, 0.9) > 1.2 * np.quantile(speeds, 0.1),
    )

    def flipping(axis: int) -> GapShape:
        def words(c: Array) -> str:
            return (
                f'flips with the sense of travel of {axes[axis]}: {direction_words(c)} forward, '
                'the opposite backward'
            )

        return GapShape('sense', lambda v: one(_sense(v, axis)), words)

    def growing(axis: int) -> GapShape:
        def words(c: Array) -> str:
            return (
                f'flips with the sense of travel of {axes[axis]} and grows with its feed: '
                f'{direction_words(c, 1e5, PER_FEED)} forward'
            )

        return GapShape('feed', lambda v: one(v.speed * v.direction[:, axis]), words)

    yield from (flipping(axis) for axis in range(3))
    if two_feeds:
        yield from (growing(axis) for axis in range(3))
        yield GapShape(
            'feed',
            lambda v: one(v.speed - v.speed.mean()),
            lambda c: f'changes with the feed: {direction_words(c, 1e5, PER_FEED)}',
        )


def _spacing(view: RunView, axis: int) -> Array:
    """Distance of neighbouring pieces along an axis, shape (p,), m."""
    length = np.zeros(len(view.leg))
    for low, high in view.bounds:
        steps = np.abs(np.diff(view.q[low:high, axis]))
        length[low:high] = float(np.median(steps)) if steps.size else 0.0
    return length


def wave_shapes(views: Sequence[RunView], axis: int) -> Iterator[GapShape]:
    """Waves along the position of an axis; means over pieces weaken short ones."""
    name, spacing = views[0].axis_names[axis], {id(v): _spacing(v, axis) for v in views}
    every = np.concatenate(list(spacing.values()))
    moving = every[every > 1e-6]
    length = float(np.ptp(np.concatenate([v.q[:, axis] for v in views])))
    if not moving.size or length < 1e-3:
        return

    def shape(frequency: float, width: float) -> GapShape:
        def scales(view: RunView) -> Array:
            weak = np.sinc(frequency * spacing[id(view)])
            return np.asarray(weak[:, None] * wave(2.0 * np.pi * frequency * view.q[:, axis]))

        def words(c: Array) -> str:
            return f'period {1e3 / frequency:.1f} mm of axis {name}, {amplitude_words(c)}'

        return GapShape(f'wave {name}', scales, words, finer_shapes(shape, frequency, width))

    low, high = WAVES_PER_AXIS / length, 1.0 / (SHORTEST_WAVE * float(np.quantile(moving, 0.1)))
    count = max(2, min(MOST_WAVES, int((high - low) * 2 * length)))
    width = (high - low) / (count - 1)
    yield from (shape(float(f), width) for f in np.linspace(low, high, count))


def slow_wave_shapes(views: Sequence[RunView]) -> Iterator[GapShape]:
    """Waves in time, slower than legs."""
    longest = max(float(np.ptp(v.time)) for v in views)
    legs = max(len(v.bounds) for v in views)

    def shape(cycles: float, width: float) -> GapShape:
        period = longest / cycles
        return GapShape(
            'slow wave',
            lambda v: wave(2.0 * np.pi / period * v.time),
            lambda c: f'period {period:.3g} s, {amplitude_words(c)}',
            finer_shapes(shape, cycles, width),
        )

    cycles = np.arange(SLOWEST_WAVE, min(FASTEST_WAVE, 0.4 * legs), 0.5)
    yield from (shape(float(n), 0.5) for n in cycles)


def product_shapes(views: Sequence[RunView]) -> Iterator[GapShape]:
    """What changes along one axis with the position of another."""
    axes, q = views[0].axis_names, np.concatenate([v.q for v in views])
    middle, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0)

    def shape(a: int, b: int) -> GapShape:
        def words(c: Array) -> str:
            return (
                f'grows with the product of the positions of {axes[a]} and {axes[b]}, '
                f'to {direction_words(c)}'
            )

        def scales(view: RunView) -> Array:
            u = (view.q - middle) / half.clip(1e-3)
            return one(u[:, a] * u[:, b])

        return GapShape('product', scales, words)

    pairs = ((0, 1), (0, 2), (1, 2))
    yield from (shape(a, b) for a, b in pairs if min(half[a], half[b]) > 1e-3)


def all_shapes(views: Sequence[RunView]) -> list[list[GapShape]]:
    """All shapes, one list a family that is scanned together."""
    families = (step_shapes, drift_shapes, travel_shapes, slow_wave_shapes, product_shapes)
    found = [list(family(views)) for family in families]
    return found + [list(wave_shapes(views, axis)) for axis in range(3)]

# SPDX-License-Identifier: Apache-2.0
"""Plain shapes that a gap of unknown cause may have: step, drift, wave, sense of travel, feed.

Each is a displacement in the machine frame that is linear in its coefficients; its words say what
it looks like, not what causes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.views import RunView
from otf_core.machine import AXES

Array = NDArray[np.float64]
Columns = Callable[[RunView], Array]

MAX_STEPS = 60
"""Moments per run at which a step is looked for."""
SLOWEST_WAVE, FASTEST_WAVE = 1.5, 40.0
"""Waves in time: cycles per run."""
MOST_WAVES = 120
"""Lengths of waves looked for along an axis."""
WAVES_PER_AXIS = 3.0
"""Longer waves are for the tables."""
SHORTEST_WAVE = 2.2
"""Spacings of the pieces along the axis on the slowest lines."""
MOVING = 0.05


@dataclass(frozen=True)
class Shape:
    """A displacement with coefficients.

    Attributes
    ----------
    family : str
    columns : callable(RunView) -> ndarray, shape (p, 3, k)
        Displacement per coefficient; coefficients come in threes: along X, Y, Z.
    words : callable(coefficients) -> str
    """

    family: str
    columns: Columns
    words: Callable[[Array], str]


def _vector(scale: Array) -> Array:
    """Displacement along X, Y, Z in proportion to ``scale``, shape (p, 3, 3)."""
    return np.asarray(scale[:, None, None] * np.eye(3))


def direction_words(vector: Array, scale: float = 1e6, unit: str = 'um') -> str:
    """Size and direction of a displacement in words."""
    size = float(np.linalg.norm(vector))
    main = int(np.argmax(np.abs(vector)))
    if abs(vector[main]) > 0.9 * size:
        sign = '+' if vector[main] > 0 else '-'
        return f'{scale * size:.2g} {unit} along machine {sign}{AXES[main]}'
    parts = ', '.join(f'{scale * v:.2g}' for v in vector)
    return f'{scale * size:.2g} {unit} along X, Y, Z = ({parts})'


def _amplitude(value: Array) -> Array:
    """Amplitude along X, Y, Z of a wave with sine and cosine coefficients."""
    return np.hypot(value[:3], value[3:])


def _amplitude_words(value: Array) -> str:
    amplitude = _amplitude(value)
    size, main = float(np.linalg.norm(amplitude)), int(np.argmax(amplitude))
    if amplitude[main] > 0.9 * size:
        return f'amplitude {1e6 * amplitude[main]:.2g} um along {AXES[main]}'
    parts = ', '.join(f'{1e6 * v:.2g}' for v in amplitude)
    return f'amplitudes along X, Y, Z of ({parts}) um'


def step_shapes(views: Sequence[RunView]) -> Iterator[Shape]:
    """A step between two legs."""
    for view in views:
        starts = np.array([view.time[low] for low, _ in view.bounds])[2:-2]
        chosen = starts[:: max(1, -(-len(starts) // MAX_STEPS))]
        where = f' in {view.name}' if len(views) > 1 else ''
        for start in chosen:
            yield Shape(
                'step',
                lambda v, t=start, r=view: _vector(((v.time >= t) & (v is r)).astype(float)),
                lambda c, t=start, w=where: f'since {t:.0f} s{w}, step of {direction_words(c)}',
            )


def drift_shapes(views: Sequence[RunView]) -> Iterator[Shape]:
    """A steady drift."""
    for view in views:
        where = f' in {view.name}' if len(views) > 1 else ''
        yield Shape(
            'drift',
            lambda v, r=view: _vector((v.time - v.time.mean()) / 60.0 * (v is r)),
            lambda c, w=where: f'drift of {direction_words(c, 1e6, "um/min")}{w}',
        )


def travel_shapes(views: Sequence[RunView]) -> Iterator[Shape]:
    """What flips with the sense of travel, alike at all feeds or growing with the feed."""
    speeds = np.concatenate([v.speed for v in views])
    two_feeds = np.quantile(speeds, 0.9) > 1.2 * np.quantile(speeds, 0.1)

    def sense(view: RunView, axis: int) -> Array:
        d = view.direction[:, axis]
        return np.where(np.abs(d) < MOVING, 0.0, np.sign(d))

    for axis, name in enumerate(AXES):
        yield Shape(
            'sense',
            lambda v, a=axis: _vector(sense(v, a)),
            lambda c, n=name: (
                f'flips with the sense of travel of {n}: {direction_words(c)} forward, '
                f'the opposite backward'
            ),
        )
        if two_feeds:
            yield Shape(
                'feed',
                lambda v, a=axis: _vector(v.speed * v.direction[:, a]),
                lambda c, n=name: (
                    f'flips with the sense of travel of {n} and grows with its feed: '
                    f'{direction_words(c, 1e5, "um per 0.1 m/s")} forward'
                ),
            )
    if two_feeds:
        yield Shape(
            'feed',
            lambda v: _vector(v.speed - v.speed.mean()),
            lambda c: f'changes with the feed, {direction_words(c, 1e5, "um per 0.1 m/s")}',
        )


def _spacing(view: RunView, axis: int) -> Array:
    """Distance of neighbouring pieces along an axis, shape (p,), m."""
    length = np.zeros(len(view.leg))
    for low, high in view.bounds:
        steps = np.abs(np.diff(view.q[low:high, axis]))
        length[low:high] = float(np.median(steps)) if steps.size else 0.0
    return length


def wave_shapes(views: Sequence[RunView]) -> Iterator[Shape]:
    """Waves along the position of an axis; means over pieces weaken short ones."""
    for axis, name in enumerate(AXES):
        q = np.concatenate([v.q[:, axis] for v in views])
        spacing = np.concatenate([_spacing(v, axis) for v in views])
        moving = spacing[spacing > 1e-6]
        length = float(np.ptp(q))
        if not moving.size or length < 1e-3:
            continue
        low, high = WAVES_PER_AXIS / length, 1.0 / (SHORTEST_WAVE * np.quantile(moving, 0.1))
        count = min(MOST_WAVES, int((high - low) * 2 * length))
        for frequency in np.linspace(low, high, max(count, 1)):

            def columns(view: RunView, f: float = frequency, a: int = axis) -> Array:
                weak = np.sinc(f * _spacing(view, a))
                phase = 2.0 * np.pi * f * view.q[:, a]
                parts = [_vector(weak * np.sin(phase)), _vector(weak * np.cos(phase))]
                return np.concatenate(parts, axis=2)

            yield Shape(
                f'wave {name}',
                columns,
                lambda c, f=frequency, n=name: (
                    f'period {1e3 / f:.1f} mm of axis {n}, {_amplitude_words(c)}'
                ),
            )


def slow_wave_shapes(views: Sequence[RunView]) -> Iterator[Shape]:
    """Waves in time, slower than legs."""
    longest = max(float(np.ptp(v.time)) for v in views)
    legs = max(len(v.bounds) for v in views)
    for cycles in np.arange(SLOWEST_WAVE, min(FASTEST_WAVE, 0.4 * legs), 0.5):
        omega = 2.0 * np.pi * cycles / longest

        def columns(view: RunView, w: float = omega) -> Array:
            parts = [_vector(np.sin(w * view.time)), _vector(np.cos(w * view.time))]
            return np.concatenate(parts, axis=2)

        yield Shape(
            'slow wave',
            columns,
            lambda c, w=omega: f'period {2 * np.pi / w:.0f} s, {_amplitude_words(c)}',
        )


def product_shapes(views: Sequence[RunView]) -> Iterator[Shape]:
    """What changes along one axis with the position of another."""
    q = np.concatenate([v.q for v in views])
    middle, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        if min(half[a], half[b]) < 1e-3:
            continue

        def columns(view: RunView, i: int = a, j: int = b) -> Array:
            u = (view.q - middle) / np.maximum(half, 1e-3)
            return _vector(u[:, i] * u[:, j])

        yield Shape(
            'product',
            columns,
            lambda c, m=f'{AXES[a]} and {AXES[b]}': (
                f'grows with the product of the positions of {m}, to {direction_words(c)}'
            ),
        )


def all_shapes(views: Sequence[RunView]) -> list[list[Shape]]:
    """All shapes, one list a family that is scanned together."""
    families = (step_shapes, drift_shapes, travel_shapes, slow_wave_shapes, product_shapes)
    found = [list(family(views)) for family in families]
    waves = list(wave_shapes(views))
    return found + [[w for w in waves if w.family == f'wave {a}'] for a in AXES]

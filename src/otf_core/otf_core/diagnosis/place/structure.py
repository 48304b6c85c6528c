# SPDX-License-Identifier: Apache-2.0
"""Shape of a gap that no known effect explains, in words.

What a plain shape of a gap is: a displacement and its words.

The displacement, in the machine frame, is linear in its coefficients; the words say what it looks
like, not what causes it.

Shapes that a gap of unknown cause is compared with: step, drift, travel, feed, waves.

Shapes are fitted to the residual, freed of the correlation of the noise; the one that explains
most, less the price of its coefficients and of having looked at many, is taken, then the next on
what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.diagnosis.place.groups import RunView
from otf_core.model.frames import XYZ
from otf_core.model.path import TRAVELS
from otf_core.solving.normal import rows_by_run
from otf_core.solving.residuals import check_residuals

Scales = Callable[[RunView], Array]

FINER = 4
"""Shapes looked at on either side when the best one is refined."""


@dataclass(frozen=True)
class GapShape:
    """A displacement with coefficients.

    Attributes
    ----------
    scales : callable(RunView) -> ndarray, shape (p, m)
        Displacements along X, Y and Z are in proportion to each of the m scales; coefficients
        are those of the first scale, X, Y, Z, then of the next.
    words : callable(coefficients) -> str
    finer : callable() -> list of GapShape, optional
        Shapes in between this one and its neighbours, for a shape with a moment, a period or a
        time constant.
    """

    family: str
    scales: Scales
    words: Callable[[Array], str]
    finer: Callable[[], list[GapShape]] | None = None


Maker = Callable[[float, float], GapShape]
"""Makes a shape from the value of its parameter and the distance to its neighbours."""


def finer_shapes(maker: Maker, value: float, width: float) -> Callable[[], list[GapShape]]:
    """Shapes about a value of the parameter, once they are asked for."""
    steps = np.arange(-FINER, FINER + 1) / FINER
    return lambda: [maker(float(value + s * width), width / FINER) for s in steps]


def one(scale: NDArray[Any]) -> Array:
    """Return a single scale, shape (p, 1)."""
    return np.asarray(scale, dtype=np.float64)[:, None]


def wave(phase: Array) -> Array:
    """Sine and cosine, shape (p, 2)."""
    return np.stack([np.sin(phase), np.cos(phase)], axis=1)


def direction_words(vector: Array, scale: float = 1e6, unit: str = 'um') -> str:
    """Size and direction of a displacement in words."""
    size = float(np.linalg.norm(vector))
    main = int(np.argmax(np.abs(vector)))
    if abs(vector[main]) > 0.9 * size:
        sign = '+' if vector[main] > 0 else '-'
        return f'{scale * size:.2g} {unit} along machine {sign}{XYZ[main]}'
    parts = ', '.join(f'{scale * v:.2g}' for v in vector)
    return f'{scale * size:.2g} {unit} along X, Y, Z = ({parts})'


def _amplitude(value: Array) -> Array:
    """Amplitude along X, Y, Z of a wave with sine and cosine coefficients."""
    return np.hypot(value[:3], value[3:])


def amplitude_words(value: Array) -> str:
    """Amplitude and direction of a wave in words."""
    amplitude = _amplitude(value)
    size, main = float(np.linalg.norm(amplitude)), int(np.argmax(amplitude))
    if amplitude[main] > 0.9 * size:
        return f'amplitude {1e6 * amplitude[main]:.2g} um along {XYZ[main]}'
    parts = ', '.join(f'{1e6 * v:.2g}' for v in amplitude)
    return f'amplitudes along X, Y, Z of ({parts}) um'


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

    yield from (flipping(axis) for axis in range(len(axes)))
    if two_feeds:
        yield from (growing(axis) for axis in range(len(axes)))
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

    pairs = combinations(range(len(axes)), 2)
    yield from (shape(a, b) for a, b in pairs if min(half[a], half[b]) > 1e-3)


def all_shapes(views: Sequence[RunView]) -> list[list[GapShape]]:
    """All shapes, one list a family that is scanned together."""
    families = (step_shapes, drift_shapes, travel_shapes, slow_wave_shapes, product_shapes)
    shapes = [list(family(views)) for family in families]
    return shapes + [list(wave_shapes(views, axis)) for axis in range(len(XYZ))]


Projection = Callable[[Array], Array]
_Family = tuple[list['_Candidate'], int]
"""Candidates, and how many shapes were looked at."""

MAX_STRUCTURES, NEEDED_SCORE = 3, 9.0
"""Shapes named; logarithm of the odds that each needs."""
NEEDED_SHARE = 0.1
"""Share of the excess that a shape must explain to be worth a word."""
SEVERAL = ('sense', 'product')
"""Families that may be found more than once."""
REFINEMENTS = 3
KEPT = 8
"""Of many shapes of a family so many are fitted exactly."""
TOGETHER = 8
"""Shapes whose columns are made at once; bounds the memory."""
EXACT = 24
"""Families of more shapes are screened."""


@dataclass(frozen=True)
class GapStructure:
    """One shape found in the residual.

    Attributes
    ----------
    share : float
        Of the squared residual beyond noise that it explains, 0 to 1.
    score : float
        Logarithm of the odds against noise.
    """

    family: str
    words: str
    share: float
    score: float


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A shape, by the products of its whitened columns with each other and with the residual."""

    shape: GapShape
    normal: Array
    right: Array

    def without(
        self, views: Sequence[RunView], pull: Sequence[Array], amount: Array
    ) -> _Candidate:
        """Leave out what orthonormal columns can follow.

        Parameters
        ----------
        pull : sequence of ndarray, shape (p, 3, q)
            Of every run, see ``_pulled``.
        amount : ndarray, shape (q,)
            Of the residual along them.
        """
        shared = self._shared(views, pull)
        return _Candidate(
            self.shape, self.normal - shared.T @ shared, self.right - shared.T @ amount
        )

    def _shared(self, views: Sequence[RunView], pull: Sequence[Array]) -> Array:
        """Products of orthonormal columns with those of the shape, shape (q, k)."""
        parts = (
            np.einsum('pm,piq->qmi', self.shape.scales(view), own, optimize=True)
            for view, own in zip(views, pull, strict=True)
        )
        return np.asarray(sum(parts)).reshape(pull[0].shape[2], -1)


def _columns(
    views: Sequence[RunView], shapes: Sequence[GapShape], project: Projection
) -> list[Array]:
    """Whitened columns of shapes of equal numbers of scales, less what tables follow."""
    wide = []
    for view in views:
        scales = np.concatenate([s.scales(view) for s in shapes], axis=1)
        columns = scales[None, :, :, None] * view.axes[:, :, None, :]
        wide.append(view.whiten(columns.reshape(*view.axes.shape[:2], -1)))
    return np.split(project(np.concatenate(wide)), len(shapes), axis=1)


def _candidates(
    views: Sequence[RunView],
    shapes: Sequence[GapShape],
    residual: Array,
    project: Projection,
) -> list[_Candidate]:
    """Shapes of equal numbers of scales, by their products; some of them at once."""
    candidates = []
    for k in range(0, len(shapes), TOGETHER):
        some = shapes[k : k + TOGETHER]
        for shape, white in zip(some, _columns(views, some, project), strict=True):
            candidates.append(_Candidate(shape, white.T @ white, white.T @ residual))
    return candidates


def _pulled(views: Sequence[RunView], white: Array, project: Projection) -> list[Array]:
    """Whitened columns (r, q) of every run set up for products with displacements, (p, 3, q)."""
    columns = project(white).T
    parts = [[v.vectors(v.whitener.whiten_transposed(part)) for v, part in _parts(views, own)]
             for own in columns]  # fmt: skip
    return [np.stack(own, axis=2) for own in zip(*parts, strict=True)]


def _screened(
    views: Sequence[RunView], shapes: Sequence[GapShape], residual: Array, project: Projection
) -> list[_Candidate]:
    """Most promising of many shapes: exact products with the residual, sizes interpolated."""
    if len(shapes) <= EXACT:
        return _candidates(views, shapes, residual, project)
    pull = [v.vectors(v.whitener.whiten_transposed(part)) for v, part in _parts(views, residual)]
    sample = np.unique(np.linspace(0, len(shapes) - 1, EXACT // 2).round().astype(int))
    exact = _candidates(views, [shapes[k] for k in sample], residual, project)
    known = np.array([c.normal.diagonal() for c in exact]).T
    numbers, gains = np.arange(len(shapes)), []
    diagonals = np.stack([np.interp(numbers, sample, own) for own in known], axis=1)
    for shape, diagonal in zip(shapes, diagonals, strict=True):
        products = sum(shape.scales(v).T @ p for v, p in zip(views, pull, strict=True))
        right = np.asarray(products).ravel()
        gains.append(float((right**2 / np.maximum(diagonal, 1e-300)).sum()))
    best = np.argsort(gains)[::-1][:KEPT]
    return _candidates(views, [shapes[k] for k in np.sort(best)], residual, project)


def _fit(normal: Array, right: Array) -> tuple[Array, float]:
    """Coefficients and fall of the sum of squares; blind directions stay at rest."""
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    value, vectors = np.linalg.eigh(normal / np.outer(size, size))
    use = value > 1e-6
    scaled = vectors[:, use] / value[use] @ (vectors[:, use].T @ (right / size))
    coefficients = scaled / size
    return coefficients, float(right @ coefficients)


def _parts(views: Sequence[RunView], white: Array) -> Iterator[tuple[RunView, Array]]:
    """Whitened values (r,) run by run, shape (c, p)."""
    return zip(views, rows_by_run(white, [v.expected.shape for v in views]), strict=True)


def _inflation(views: Sequence[RunView], residual: Array) -> float:
    """Variance of what counts as noise in a whitened residual, correlation included."""
    parts = _parts(views, residual)
    return float(np.mean([check_residuals(p, v.leg, 0).inflation for v, p in parts]))


def _squares(views: Sequence[RunView], white: Array) -> float:
    """Sum of squares of whitened values turned back, m^2."""
    return sum(float((v.whitener.unwhiten(p) ** 2).sum()) for v, p in _parts(views, white))


@dataclass(frozen=True, eq=False)
class _Best:
    """The best shape, its columns and coefficients, and the logarithm of its odds."""

    shape: GapShape
    white: Array
    value: Array
    score: float


def _best(
    families: Sequence[_Family],
    views: Sequence[RunView],
    residual: Array,
    project: Projection,
) -> _Best:
    """Shape that explains most of a residual."""
    legs = sum(len(v.bounds) for v in views)
    ranked = []
    for family, looked in families:
        gains = [_fit(c.normal, c.right)[1] for c in family]
        best = int(np.argmax(gains))
        price = 0.5 * len(family[best].right) * np.log(legs) + np.log(looked)
        ranked.append((family[best], gains[best], float(price)))
    candidate, _, price = max(ranked, key=lambda r: 0.5 * r[1] - r[2])
    shape = _refined(candidate, views, residual, project).shape
    (white,) = _columns(views, [shape], project)
    value, gain = _fit(white.T @ white, white.T @ residual)
    variance = _inflation(views, residual - white @ value)
    return _Best(shape, white, value, 0.5 * gain / variance - price)


def _refined(
    candidate: _Candidate, views: Sequence[RunView], residual: Array, project: Projection
) -> _Candidate:
    """Best shape near a shape with a moment, a period or a time constant."""
    for _ in range(REFINEMENTS):
        if candidate.shape.finer is None:
            break
        near = _candidates(views, candidate.shape.finer(), residual, project)
        candidate = max(near, key=lambda c: _fit(c.normal, c.right)[1])
    return candidate


def _basis(columns: Array) -> Array:
    """Orthonormal basis of the columns of a shape that was found."""
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, size > 1e-3 * size.max(initial=1e-300)])


def _removal(basis: Array) -> Projection:
    """Projection that takes out what orthonormal columns can follow."""
    return lambda wide: np.asarray(wide - basis @ (basis.T @ wide))


def _chained(first: Projection, then: Projection) -> Projection:
    return lambda wide: then(first(wide))


def _without_means(views: Sequence[RunView]) -> Projection:
    """Projection that takes out a constant displacement of every run."""
    columns = [np.zeros((v.expected.size, 3)) for v in views]
    blocks = []
    for k, view in enumerate(views):
        own = view.whiten(view.axes)
        blocks.append(np.concatenate([*columns[:k], own, *columns[k + 1 :]]))
    basis = np.linalg.qr(np.concatenate(blocks, axis=1))[0]
    return lambda wide: np.asarray(wide - basis @ (basis.T @ wide))


def _joint_words(
    views: Sequence[RunView], shapes: Sequence[GapShape], residual: Array, project: Projection
) -> list[str]:
    """Words with the sizes that shapes have when all are fitted together."""
    if not shapes:
        return []
    white = [_columns(views, [shape], project)[0] for shape in shapes]
    whole = np.concatenate(white, axis=1)
    value, _ = _fit(whole.T @ whole, whole.T @ residual)
    ends = np.cumsum([w.shape[1] for w in white])
    parts = np.split(value, ends[:-1])
    return [shape.words(part) for shape, part in zip(shapes, parts, strict=True)]


def find_structures(
    views: Sequence[RunView],
    residuals: Sequence[Array] | None = None,
    project: Projection | None = None,
) -> list[GapStructure]:
    """Find plain shapes in the residual, the one that explains most first.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (c, p), m, optional
        ``residual_before`` where not given.
    project : callable(columns (r, k)) -> columns, optional
        Takes out of whitened columns what tables and poses can follow, ``Rows.project``; without
        it only a constant displacement of every run is taken out, and sizes are those that
        tables and poses leave.
    """
    project = project or _without_means(views)
    given = residuals if residuals is not None else [v.residual_before for v in views]
    residual = project(
        np.concatenate([v.whiten(r[:, :, None]) for v, r in zip(views, given, strict=True)])
    )[:, 0]
    noise = sum(float((v.expected**2).sum()) for v in views)
    first = _squares(views, residual)
    families = [
        (_screened(views, family, residual, project), len(family))
        for family in all_shapes(views)
        if family
    ]
    structures: list[GapStructure] = []
    chosen: list[GapShape] = []
    plain, whole = project, residual
    while families and len(structures) < MAX_STRUCTURES:
        best = _best(families, views, residual, project)
        before, basis = _squares(views, residual), _basis(best.white)
        amount, residual = basis.T @ residual, residual - best.white @ best.value
        gain = before - _squares(views, residual)
        share = gain / max(first - noise, 0.1 * noise)
        if best.score < NEEDED_SCORE or share < NEEDED_SHARE:
            break
        chosen.append(best.shape)
        structures.append(GapStructure(best.shape.family, '', min(share, 1.0), best.score))
        # axes may each have their own sense of travel; a second step or wave is a refinement
        family, pull = best.shape.family, _pulled(views, basis, plain)
        families = [
            ([c.without(views, pull, amount) for c in part], looked)
            for part, looked in families
            if family in SEVERAL or part[0].shape.family != family
        ]
        project = _chained(project, _removal(basis))
    words = _joint_words(views, chosen, whole, plain)
    structures = [replace(s, words=w) for s, w in zip(structures, words, strict=True)]
    return sorted(structures, key=lambda s: -s.share)

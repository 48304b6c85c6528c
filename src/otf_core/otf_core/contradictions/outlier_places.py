# SPDX-License-Identifier: Apache-2.0
"""Samples that were left out as outliers: where they lie, and whether that is regular.

Bad samples come anywhere, and are few. What lies at the same place of a line in every pass over
it, or at the corners alone, is no bad sample but something that the machine does: a dent in a
guide, a chip under a slide, corners that the control rounds. So is what takes up much of all
lines, as the crests of a wave do; what they leave behind would look smaller than it is.

Stray samples spread over all lines meet at the same places by chance: of 3 % at 500 Hz and 0.25
m/s a stretch of 20 mm holds one in seven passes of ten. So agreement between passes counts only
beyond chance, as Cohen's kappa has it: (seen - chance) / (1 - chance), chance being what as many
stretches would show if they were strewn over the lines without order.

References
----------
J. Cohen, A coefficient of agreement for nominal scales, Educ. Psychol. Meas. 20 (1960) 37-46.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.model.frames import XYZ
from otf_core.pieces.finding import WARNING, Finding
from otf_core.pieces.runs import Run
from otf_core.tracking.curves import Lines

STRETCH_LENGTH = 0.02
"""m; stretches of a line that are compared between passes."""
SAME_POINT = 1e-3
"""m; raster by which lines are distinguished."""
MAX_CORNER_DISTANCE, MAX_CORNER_SHARE_OF_LEG = 0.06, 0.25
"""m, and share of its leg, within which a sample lies near a corner."""
MIN_REGULAR_SHARE = 0.7
"""Share of what is left out from which a rule holds."""
MAX_SHARE_OF_ALL = 0.5
"""Share near corners of all samples, over that of those left out, up to which that is a rule."""
MIN_SAMPLES, MIN_PLACES = 20, 3
"""Samples, and corners or stretches, that are needed to establish a rule."""
WARNING_SHARE = 0.01
"""Share of all samples from which outliers are reported in any case."""
MANY_SHARE = 0.1
"""Share of all samples from which they are hardly bad ones, unless something reflects the beam."""
MAX_LISTED = 4
"""Places that are named."""
MAX_USED_SAMPLES = 400_000
"""Samples that were kept; of more, every second, third, ... is used."""


@dataclass(frozen=True)
class OutlierPlaces:
    """What was left out of a run.

    Attributes
    ----------
    name : str
        Of the run; empty if it has none.
    samples, of : int
        Left out, and all that lie on the lines away from corners and stops.
    legs : int
        Legs on which they lie.
    repeated : float
        Share of it that was left out in every pass, where the line was driven more than once,
        beyond what chance makes: 1 always, 0 no more often than by chance.
    near_corners, others : float
        Share of it, and of all, that lies near corners.
    places : tuple of three floats each
        Machine coordinates of stretches that it takes up, the fullest first, m.
    """

    name: str
    samples: int
    of: int
    legs: int
    repeated: float
    near_corners: float
    others: float
    places: tuple[tuple[float, ...], ...]

    @property
    def again(self) -> bool:
        """Whether it lies at the same places in every pass."""
        return self._enough and self.repeated >= MIN_REGULAR_SHARE

    @property
    def at_corners(self) -> bool:
        """Whether it lies near corners alone."""
        return (
            self._enough
            and self.others / MAX_SHARE_OF_ALL <= self.near_corners >= MIN_REGULAR_SHARE
        )

    @property
    def _enough(self) -> bool:
        return self.samples >= MIN_SAMPLES and len(self.places) >= MIN_PLACES

    @property
    def _shared(self) -> list[tuple[str, float]]:
        """Axes on which all that is regular lies at the same position, with that position."""
        every = np.array(self.places)
        if not self.again or self.at_corners:
            return []
        middle = np.median(every, axis=0)
        close = np.mean(np.abs(every - middle) < STRETCH_LENGTH, axis=0) >= MIN_REGULAR_SHARE
        alone = close.sum() < len(XYZ)
        return [(a, float(m)) for a, m, c in zip(XYZ, middle, close, strict=True) if c and alone]

    @property
    def too_many(self) -> bool:
        """Whether it is more than bad samples ever are."""
        return self._enough and self.samples > MANY_SHARE * self.of

    @property
    def by_machine(self) -> bool:
        """Whether it is something that the machine does, and no bad samples."""
        return self.again or self.at_corners or self.too_many

    def words(self) -> str:
        """What was left out, and where."""
        where = '; '.join(
            ' '.join(f'{a} {v:.3f}' for a, v in zip(XYZ, place, strict=True))
            for place in self.places[:MAX_LISTED]
        )
        more = ', ...' if len(self.places) > MAX_LISTED else ''
        more += ''.join(f', all near {a} {v:.3f}' for a, v in self._shared)
        head = f'{self.name}: ' if self.name else ''
        if not self.places:
            return f'{head}{self.samples} samples left out as outliers'
        text = (
            f'{head}{self.samples} samples left out as outliers, on {self.legs} legs, '
            f'{100 * self.near_corners:.0f} % of them near corners; at {where}{more} m'
        )
        rules = ['at the same places in every pass'] * self.again
        rules += ['near corners alone'] * self.at_corners
        if not self.by_machine:
            return text
        if not rules:
            return (
                f'{text}. There are many of them: stray reflections or real machine behaviour; '
                f'./otf diagnose includes all but the most distant in the gap'
            )
        return (
            f'{text}. They lie {" and ".join(rules)}: probably real machine behaviour '
            f'rather than bad samples; ./otf diagnose includes them in the gap'
        )


def locate_outliers(run: Run, without_outliers: Run) -> OutlierPlaces:
    """Where the samples lie that were left out of a run.

    Parameters
    ----------
    run : Run
        With all its pieces.
    without_outliers : Run
        With those that were not far from the solution.
    """
    gone = np.zeros(len(run.samples), dtype=bool)
    gone[run.pieces.samples] = True
    gone[without_outliers.pieces.samples] = False
    lost = np.concatenate([np.flatnonzero(gone), run.pieces.far]).astype(np.int64)
    if run.pieces.standstill or not len(lost):  # stops lie at points, on no line
        return OutlierPlaces(run.name, len(lost), run.pieces.used, 0, 0.0, 0.0, 0.0, ())
    step = max(1, len(without_outliers.pieces.samples) // MAX_USED_SAMPLES)
    stays = without_outliers.pieces.samples[::step].astype(np.int64)
    index = np.concatenate([stays, lost])
    out = np.arange(len(index)) >= len(stays)
    lines, leg = Lines.of(run.shape), run.alignment.leg[index].astype(np.int64)
    along = lines.seen_from(run.pose).along(run.samples.xyz.take(index, axis=0), leg)
    whole, own = lines.total[leg], lines.start[leg] + along
    near = np.minimum(own, whole - own) < np.minimum(
        MAX_CORNER_DISTANCE, MAX_CORNER_SHARE_OF_LEG * whole
    )
    cell = _cells(run.shape.corners, leg, along, lines.length[leg])
    places = _places(lines.at(along[out], leg[out]), cell[out])
    return OutlierPlaces(
        name=run.name,
        samples=len(lost),
        of=len(without_outliers.pieces.samples) + len(lost),
        legs=len(np.unique(leg[out])),
        repeated=_repeated(cell, leg, out),
        near_corners=float(near[out].mean()) if len(lost) else 0.0,
        others=float(near.mean()) if len(index) else 0.0,
        places=places,
    )


def _cells(corners: Array, leg: Index, along: Array, length: Array) -> Index:
    """Number of the stretch of a line on which each sample lies, whatever the sense of travel."""
    raster = np.rint(corners / SAME_POINT).astype(np.int64)
    first, last = raster[:-1], raster[1:]
    turned = np.array([tuple(a) > tuple(b) for a, b in zip(first.tolist(), last.tolist(),
                                                           strict=True)])  # fmt: skip
    ends = np.where(turned[:, None], np.hstack([last, first]), np.hstack([first, last]))
    line = np.unique(ends, axis=0, return_inverse=True)[1].reshape(-1)
    place = np.where(turned[leg], length - along, along)
    cell = np.floor(place / STRETCH_LENGTH).astype(np.int64)
    lowest = int(cell.min(initial=0))
    return np.asarray(line[leg] * (int(cell.max(initial=0)) - lowest + 1) + cell - lowest)


def _repeated(cell: Index, leg: Index, out: NDArray[np.bool_]) -> float:
    """Share of what lies in stretches driven more than once that was left out every time.

    Beyond chance: with a share r of all passes over stretches in which something was left out,
    all the n - 1 other passes over a stretch have something with the chance r^(n - 1).
    """
    legs = int(leg.max(initial=0)) + 1
    both = cell * legs + leg
    passes, lost = (_different(values) // legs for values in (both, both[out]))
    count = int(cell.max(initial=0)) + 1
    driven, rejected = np.bincount(passes, minlength=count), np.bincount(lost, minlength=count)
    again = driven[cell] > 1
    repeated = out & again
    if repeated.sum() < 0.5 * max(out.sum(), 1):
        return 0.0
    several = driven > 1
    share = rejected[several].sum() / driven[several].sum()
    chance = float(np.mean(share ** (driven[cell][repeated] - 1.0)))
    agreement = float((rejected[cell] == driven[cell])[repeated].mean())
    return max(0.0, (agreement - chance) / (1.0 - chance)) if chance < 1.0 else 0.0


def _different(values: Index) -> Index:
    """Each value of many once: samples that follow each other lie in the same stretch."""
    return np.unique(values[np.flatnonzero(np.diff(values, prepend=-1))])


def _places(q: Array, cell: Index) -> tuple[tuple[float, ...], ...]:
    """Middles of the stretches of samples that were left out, the fullest first."""
    own, inverse, count = np.unique(cell, return_inverse=True, return_counts=True)
    middle = np.stack([np.bincount(inverse.reshape(-1), q[:, k], len(own)) for k in range(3)])
    places = (middle / np.maximum(count, 1)).T[np.argsort(-count, kind='stable')]
    return tuple(tuple(float(round(v, 4)) for v in row) for row in places)


def findings(runs: Sequence[OutlierPlaces]) -> list[Finding]:
    """Findings on samples that were left out."""
    notable = [r for r in runs if r.by_machine or r.samples > WARNING_SHARE * r.of]
    return [Finding('left out', WARNING, r.words()) for r in notable]

# SPDX-License-Identifier: Apache-2.0
"""A beam found again with a shift: an offset of its own for every uninterrupted segment.

After a break a tracker may come back with another range (the interferometer lost its count) or
another point (target or tracker touched). Each segment between breaks then has an offset of its
own, a vector or a length along the beam, drawn from a normal distribution whose width the data
give (empirical Bayes; MacKay 1992). Whether the offsets are real is decided by comparison with the
same number of segments that begin in the middle of the true ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse

from otf_core.arrays import Array, Index
from otf_core.contradictions.quick_model import Fit, Model, Rows
from otf_core.model.observation import Samples
from otf_core.pieces.finding import WARNING, Finding
from otf_core.pieces.pieces import Pieces
from otf_core.pieces.runs import Run
from otf_core.tracking.measured_track import find_breaks

MAX_COLUMNS = 400
"""Offsets that are solved for at most."""
ITERATIONS = 12
"""Rounds in which the width of the distribution settles."""
MAX_WIDTH = 1e-3
"""m; standard deviation of the offsets at most."""


@dataclass(frozen=True)
class Offsets:
    """Offsets of segments.

    Attributes
    ----------
    kind : str
        'vector' or 'range'.
    value, u : ndarray, shape (segments, 3) or (segments, 1), m
        In the machine frame, or along the beam; the mean over all is free, it is the pose.
    width : float
        m; standard deviation of their distribution.
    evidence : float
        Logarithm of the odds for such offsets against none.
    """

    kind: str
    value: Array
    u: Array
    width: float
    evidence: float

    @property
    def step(self) -> float:
        """Root mean square of the length by which successive segments differ, m."""
        change = np.diff(self.value, axis=0)
        return float(np.sqrt(np.mean(np.sum(change**2, axis=1))))


def segment_of_samples(samples: Samples) -> Index:
    """Number of the uninterrupted segment of every sample, shape (n,), from 0."""
    if len(samples) < 3:
        return np.zeros(len(samples), dtype=np.int64)
    return np.concatenate([[0], np.cumsum(find_breaks(samples))])


def shift_to_middle(segment: Index) -> Index:
    """As many segments, begun in the middle of the given ones: the experiment beside."""
    begin = np.flatnonzero(np.diff(segment, prepend=-1))
    middle = (begin + np.append(begin[1:], len(segment))) // 2
    return np.searchsorted(middle[1:], np.arange(len(segment)), side='right')


def membership(pieces: Pieces, segment: Index) -> Array:
    """Share of the samples of every piece in every segment, shape (p, segments)."""
    shape = (len(pieces), int(segment.max()) + 1)
    entries = (np.ones(len(pieces.piece)), (pieces.piece, segment[pieces.samples]))
    return np.asarray(
        sparse.coo_array(entries, shape=shape).toarray() / pieces.count[:, None], dtype=np.float64
    )


def offset_columns(rows: Rows, share: Array, kind: str) -> Array:
    """Rows per m of the offset of every segment, shape (c p, segments times 3 or 1).

    Parameters
    ----------
    share : ndarray, shape (p, segments)
        Zero for the pieces of other runs.
    kind : str
        'vector' or 'range'.
    """
    vectors = (
        [rows.beam] if kind == 'range' else [np.broadcast_to(u, rows.q.shape) for u in np.eye(3)]
    )
    tiled = np.tile(share, (len(rows.axes), 1))
    parts = [tiled * rows.component(v)[:, None] for v in vectors]
    return np.stack(parts, axis=2).reshape(len(tiled), -1)


def fit_offsets(rows: Rows, fit: Fit, share: Array, kind: str) -> Offsets:
    """Estimate the offsets of segments from what a fit leaves.

    Parameters
    ----------
    fit : Fit
        Of the model without offsets; its unknowns are free again.
    share : ndarray, shape (p, segments)
    """
    columns = offset_columns(rows, share, kind)
    information, score = fit.left(columns), fit.score(columns)
    root, vectors = linalg.eigh(information)
    root, projection = np.maximum(root, 0.0), vectors.T @ score
    variance = (MAX_WIDTH / 10) ** 2
    noise = fit.ratio**2
    for _ in range(ITERATIONS):
        cover = 1.0 / (root / noise + 1.0 / variance)
        value = cover * projection / noise
        explained = float(2.0 * projection @ value - value @ (root * value))
        determined = float(np.sum(1.0 - cover / variance))
        variance = float(value @ value) / max(determined, 1e-9)
        variance = float(np.clip(variance, 1e-16, MAX_WIDTH**2))
        noise = max(fit.square - explained, 1e-12) / max(fit.freedom - determined, 1.0)
    cover = 1.0 / (root / noise + 1.0 / variance)
    value = cover * projection / noise
    evidence = 0.5 * float(projection @ value) / noise
    evidence -= 0.5 * float(np.sum(np.log1p(root * variance / noise)))
    u = np.sqrt(np.einsum('ij,j,ij->i', vectors, cover, vectors))
    shape = (share.shape[1], -1)
    return Offsets(
        kind,
        (vectors @ value).reshape(shape),
        u.reshape(shape),
        float(np.sqrt(variance)),
        evidence,
    )


MIN_EVIDENCE_PER_ROW = 0.03
"""Logarithm of the odds per row from which on offsets are real; other misfit gave up to 0.02."""
MIN_EVIDENCE_OVER_CONTROL = 0.03
"""By how much they must be better placed at the breaks than between them, per row."""
KINDS = {'vector': 3, 'range': 1}


@dataclass(frozen=True)
class SegmentOffsets:
    """Offsets of the segments of one run.

    Attributes
    ----------
    segment : ndarray of int64, shape (n,)
        Of every sample.
    """

    run: int
    segment: Index
    offsets: Offsets


def find_offsets(model: Model, run: int) -> SegmentOffsets | None:
    """Find offsets of the segments of one run; None if there are none."""
    pieces, rows = model.runs[run].pieces, model.rows
    segment = segment_of_samples(model.runs[run].recording.samples)
    count = int(segment[-1]) + 1
    if count < 2 or not len(pieces.samples):
        return None
    mine = np.flatnonzero(rows.run == run)

    def of(segments: Index, kind: str) -> Offsets:
        share = np.zeros((len(rows), int(segments.max()) + 1))
        share[mine] = membership(pieces, segments)[rows.piece[mine]]
        return fit_offsets(rows, model.fit, share, kind)

    kinds = [k for k, width in KINDS.items() if width * count <= MAX_COLUMNS]
    if not kinds:
        return None
    real = [of(segment, kind) for kind in kinds]
    best = max(real, key=lambda o: o.evidence)
    beside = of(shift_to_middle(segment), best.kind)
    size = rows.deviation.shape[0] * len(mine)
    if (
        best.evidence < MIN_EVIDENCE_PER_ROW * size
        or best.evidence - beside.evidence < MIN_EVIDENCE_OVER_CONTROL * size
    ):
        return None
    return SegmentOffsets(run, segment, best)


def remove_offsets(run: Run, again: SegmentOffsets) -> Run:
    """Take the offsets of its segments off the samples and pieces of a run."""
    samples, pieces, value = run.samples, run.pieces, again.offsets.value
    if again.offsets.kind == 'range':
        beam = samples.xyz / np.linalg.norm(samples.xyz, axis=1)[:, None]
        offset: Array = beam * value[again.segment]
    else:
        offset = (value @ run.pose.rotation)[again.segment]
    xyz = pieces.xyz - pieces.mean_of([offset[pieces.samples]])
    samples = replace(samples, xyz=samples.xyz - offset)
    return replace(run, samples=samples, pieces=replace(pieces, xyz=xyz))


def settle_offsets(model: Model, *, repair: bool) -> tuple[Model, list[Finding]]:
    """Find offsets of segments, take them off and solve anew; all runs."""
    findings: list[Finding] = []
    runs = list(model.runs)
    for k in range(len(runs)):
        again = find_offsets(model, k)
        if again is not None:
            findings.append(_finding(runs[k], again, repair=repair))
            runs[k] = remove_offsets(runs[k], again) if repair else runs[k]
    return (Model.of(runs) if findings and repair else model), findings


def _finding(run: Run, again: SegmentOffsets, *, repair: bool) -> Finding:
    name = f'{run.recording.name}: ' if run.recording.name else ''
    offsets, breaks = again.offsets, int(again.segment[-1])
    times = f'{breaks} times' if breaks > 1 else 'once'
    along = ' along the beam' if offsets.kind == 'range' else ''
    repair_words = (
        f'; offsets of the parts between breaks are estimated (u '
        f'{np.mean(offsets.u) * 1e6:.2g} um) and removed'
        if repair
        else ''
    )
    return Finding('found again', WARNING, (
        f'{name}the beam was lost {times} and found again, each time '
        f'about {1e6 * offsets.step:.1f} um off{along}{repair_words}. Check the seat '
        f'of the target, and how the tracker sets its range after a break'
    ))  # fmt: skip

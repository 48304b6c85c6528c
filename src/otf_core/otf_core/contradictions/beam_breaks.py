# SPDX-License-Identifier: Apache-2.0
"""A beam found again with a shift: an offset of its own for every uninterrupted segment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.contradictions.quick_model import Model
from otf_core.contradictions.segments import (
    MAX_COLUMNS,
    Offsets,
    between,
    fitted_offsets,
    membership,
    segment_of_samples,
)
from otf_core.pieces.finding import WARNING, Finding
from otf_core.pieces.runs import Run

EVIDENCE = 0.03
"""Logarithm of the odds per row from which on offsets are real; other misfit gave up to 0.02."""
BEYOND = 0.03
"""By how much they must be better placed at the breaks than between them, per row."""
KINDS = {'vector': 3, 'range': 1}


@dataclass(frozen=True)
class FoundAgain:
    """Offsets of the segments of one run.

    Attributes
    ----------
    run : int
    segment : ndarray of int64, shape (n,)
        Of every sample.
    offsets : Offsets
    """

    run: int
    segment: Index
    offsets: Offsets


def find_offsets(model: Model, run: int) -> FoundAgain | None:
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
        return fitted_offsets(rows, model.fit, share, kind)

    kinds = [k for k, width in KINDS.items() if width * count <= MAX_COLUMNS]
    if not kinds:
        return None
    real = [of(segment, kind) for kind in kinds]
    best = max(real, key=lambda o: o.evidence)
    beside = of(between(segment), best.kind)
    size = rows.deviation.shape[0] * len(mine)
    if best.evidence < EVIDENCE * size or best.evidence - beside.evidence < BEYOND * size:
        return None
    return FoundAgain(run, segment, best)


def shifted(run: Run, found: FoundAgain) -> Run:
    """Take the offsets of its segments off the samples and pieces of a run."""
    samples, pieces, value = run.samples, run.pieces, found.offsets.value
    if found.offsets.kind == 'range':
        beam = samples.xyz / np.linalg.norm(samples.xyz, axis=1)[:, None]
        offset: Array = beam * value[found.segment]
    else:
        offset = (value @ run.pose.rotation)[found.segment]
    xyz = pieces.xyz - pieces.mean_of(offset[pieces.samples])
    samples = replace(samples, xyz=samples.xyz - offset)
    return replace(run, samples=samples, pieces=replace(pieces, xyz=xyz))


def settle_offsets(model: Model, *, mend: bool) -> tuple[Model, list[Finding]]:
    """Find offsets of segments, take them off and solve anew; all runs."""
    found: list[Finding] = []
    runs = list(model.runs)
    for k in range(len(runs)):
        again = find_offsets(model, k)
        if again is not None:
            found.append(_finding(runs[k], again, mend=mend))
            runs[k] = shifted(runs[k], again) if mend else runs[k]
    return (Model.of(runs) if found and mend else model), found


def _finding(run: Run, again: FoundAgain, *, mend: bool) -> Finding:
    name = f'{run.recording.name}: ' if run.recording.name else ''
    offsets, breaks = again.offsets, int(again.segment[-1])
    times = f'{breaks} times' if breaks > 1 else 'once'
    along = ' along the beam' if offsets.kind == 'range' else ''
    done = (
        f'; offsets of the parts between breaks are estimated (u '
        f'{np.mean(offsets.u) * 1e6:.2g} um) and taken off'
        if mend
        else ''
    )
    return Finding('found again', WARNING, (
        f'{name}the beam was lost {times} and found again, each time about '
        f'{1e6 * offsets.step:.1f} um beside{along}{done}. Check the seat '
        f'of the target, and how the tracker sets its range after a break'
    ))  # fmt: skip

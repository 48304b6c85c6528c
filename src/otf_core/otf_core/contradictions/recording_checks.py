# SPDX-License-Identifier: Apache-2.0
"""Contradictions within recordings, checked before they are aligned.

Samples given twice count as independent and make u too small. Time stamps may be equal, in blocks,
of two streams or of a wrong clock. Path and machine description may be in different units, or of
different machines.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.bags.sample_order import stamp_words
from otf_core.errors import InputError
from otf_core.files.text_table import unit_hint, unit_words
from otf_core.model.axis_path import PartsTrack
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.noise.report import MAX_LOST_SHARE
from otf_core.noise.standstill import lost_samples
from otf_core.pieces.runs import Recording, errors_of

SAME_PLACE = 1e-7
"""m; measured twice, a point differs by more: noise."""
MIN_COMMON_SHARE = 0.002
"""Share of the shorter recording from which on common samples are no chance."""
MIN_COPIED_SHARE = 0.5
"""The same where the stamps differ: rounded coordinates may be equal by chance."""


@contextmanager
def losses_stated_first(recordings: Sequence[Recording]) -> Iterator[None]:
    """State what a recording lacks before anything that contradicts it.

    Raises
    ------
    InputError
        As the block does; if more than 1 % of the samples are missing, that comes first.
    """
    try:
        yield
    except InputError as error:
        if said := '; '.join(filter(None, map(lost_words, recordings))):
            raise InputError(f'{said}; what follows may come of that: {error}') from None
        raise


def lost_words(recording: Recording) -> str:
    """State how many samples are missing by the stamps; empty if at most 1 % are."""
    samples, path = recording.samples, recording.path
    lost = lost_samples(samples, len(path.parts) if isinstance(path, PartsTrack) else 1)
    whole = lost.samples + len(samples)
    if lost.samples <= MAX_LOST_SHARE * whole:
        return ''
    return (
        f'{recording.name or "the recording"}: {lost.samples} of {whole} samples '
        f'({100 * lost.samples / whole:.0f} %) are missing by the stamps, in {lost.gaps} gaps'
    )


def check_same_samples(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that share samples; InputError names both."""
    for (i, a), (j, b) in combinations(enumerate(recordings, start=1), 2):
        shorter = min(len(a.samples), len(b.samples))
        common = same_stamp_and_place(a.samples, b.samples)
        restamped = 0
        if common <= MIN_COMMON_SHARE * shorter:
            restamped = same_points(a.samples, b.samples)
        if common <= MIN_COMMON_SHARE * shorter and restamped <= MIN_COPIED_SHARE * shorter:
            continue
        first, second = a.name or f'run {i}', b.name or f'run {j}'
        count = max(common, restamped)
        how = ' under other stamps' if restamped else ''
        raise InputError(
            f'{second}: {100 * count / shorter:.0f} % of its samples are those of {first}{how} '
            f'({count} samples); counted twice they make the stated uncertainty too small; '
            f'give every recording once, and cut recordings that overlap'
        )


def same_stamp_and_place(a: Samples, b: Samples) -> int:
    """Count samples that both hold at the same stamp."""
    _, i, j = np.intersect1d(a.stamp_ns, b.stamp_ns, return_indices=True)
    if not i.size:
        return 0
    apart = np.abs(a.xyz[i] - b.xyz[j]).max(axis=1)
    return int(np.count_nonzero(apart < SAME_PLACE))


def same_points(a: Samples, b: Samples) -> int:
    """Count different points that both hold exactly, whatever their stamps."""
    return int(np.intersect1d(_keys(a.xyz), _keys(b.xyz)).size)


def _keys(xyz: Array) -> NDArray[np.void]:
    rows = np.ascontiguousarray(xyz + 0.0)
    return rows.view(np.dtype((np.void, rows.dtype.itemsize * 3))).ravel()


MAX_SPEED, MIN_SPEED = 20.0, 1e-3
"""m/s; no machine tool drives faster, no calibration path is driven slower."""
OTHER_UNIT = 30.0
"""Ratio of the sizes of track and path from which on one of them is in another unit."""
WINDOW = 20
"""Samples over which a speed is taken."""
TO_AND_FRO = 5.0
"""Ratio of the roughness of a stream to that of every second sample: one stream has below 1."""
STRIDES = 50
"""Steps between neighbours of two streams, in steps of one of them."""
MAX_COMPARED_SAMPLES = 20000
"""Samples that are compared one by one at most."""
MAX_CHECKED_SAMPLES = 100_000
"""Samples around which speed and roughness are evaluated; of more, spread evenly."""


def check_stamps(recordings: Sequence[Recording]) -> None:
    """Refuse stamps that do not ascend or that belong to two streams; InputError states why."""
    for recording in recordings:
        with errors_of(recording.name):
            on_lines = not isinstance(recording.path, PartsTrack)
            check_samples(recording.samples, recording.path if on_lines else None)


def check_samples(samples: Samples, path: NominalPath | None) -> None:
    """Ask one run; without a path the speed is not judged, for want of a unit."""
    step = np.diff(samples.stamp_ns)
    if len(step) and step.min() < 0:
        raise InputError('stamps go back; sort the samples by their time of measurement')
    if len(step) and step.min() == 0:
        raise InputError(f'stamps {stamp_words(samples.stamp_ns)}')
    two = two_streams(samples)
    if two:
        raise InputError(two)
    if path is None:
        return
    larger = _extent(samples.xyz) / _extent(path.points)
    if not 1.0 / OTHER_UNIT < larger < OTHER_UNIT:
        return  # the alignment names the unit
    speed = top_speed(samples)
    if speed > MAX_SPEED:
        raise InputError(
            f'by its stamps the target moves at {speed:.3g} m/s, faster than any machine tool: '
            f'are they in a unit other than ns?'
        )
    if 0.0 < speed < MIN_SPEED:
        raise InputError(
            f'by its stamps the target never moves faster than {1e3 * speed:.3g} mm/s: are they '
            f'in a unit other than ns, or was the path not driven?'
        )


def top_speed(samples: Samples) -> float:
    """Speed that the fast half of the motion exceeds, m/s; 0 for too few samples."""
    if len(samples) < 4 * WINDOW:
        return 0.0
    step = _step(len(samples) - WINDOW)
    early, late = slice(0, len(samples) - WINDOW, step), slice(WINDOW, None, step)
    moved = _lengths(samples.xyz[late] - samples.xyz[early])
    span = 1e-9 * (samples.stamp_ns[late] - samples.stamp_ns[early])
    return float(np.percentile(moved / span, 75))


def _step(count: int) -> int:
    """From one sample to the next where about ``MAX_CHECKED_SAMPLES`` of many are evaluated."""
    return -(-count // MAX_CHECKED_SAMPLES)


def _extent(points: Array) -> float:
    """Length of the longest side of a box around points (n, 3), m."""
    return max(float(np.ptp(column)) for column in points.T)  # faster than all three together


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.sqrt(np.einsum('ij,ij->i', vectors, vectors)))


def two_streams(samples: Samples) -> str:
    """State that samples alternate between two streams; empty if they do not."""
    xyz = samples.xyz
    if len(xyz) < 4 * WINDOW:
        return ''
    step = _step(len(xyz) - 2 * WINDOW)
    moved = _lengths(xyz[2 * WINDOW :: step] - xyz[: -2 * WINDOW : step])
    fast = WINDOW + step * np.flatnonzero(moved >= np.percentile(moved, 50))
    middle = 2 * xyz.take(fast, axis=0)
    one, two = (
        np.median(_lengths(xyz.take(fast + k, axis=0) - middle + xyz.take(fast - k, axis=0)))
        for k in (1, 2)
    )
    if one > TO_AND_FRO * max(float(two), 1e-7):
        return (
            f'every second sample is {_length(0.5 * float(one))} off its neighbours: two streams '
            f'that differ in clock or position are mixed on one topic; record one tracker'
        )
    if _traced(xyz[:MAX_COMPARED_SAMPLES]):
        apart = float(np.median(np.linalg.norm(np.diff(xyz, axis=0), axis=1)))
        return (
            f'the samples jump between two tracks {_length(apart)} apart: two trackers publish '
            f'on one topic; record one of them'
        )
    return ''


def _length(value: float) -> str:
    return f'{value:.2g} m' if value >= 0.1 else f'{1e3 * value:.2g} mm'


def _traced(xyz: Array) -> bool:
    """Return whether samples are two tracks, by giving each to the tip that it lies nearer to."""
    jump = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    large = float(np.percentile(jump, 95))
    if np.mean(jump > 0.5 * large) < 0.1 or large < 1e-3:
        return False
    start = int(np.argmax(jump > 0.5 * large))
    tips = xyz[start : start + 2].tolist()
    steps: list[list[float]] = [[], []]
    for point in xyz[start + 2 :].tolist():
        far = [math.dist(point, tip) for tip in tips]
        near = int(far[1] < far[0])
        steps[near].append(far[near])
        tips[near] = point
    short = [np.percentile(s, 99) if len(s) > 0.1 * len(xyz) else np.inf for s in steps]
    return bool(max(short) < large / STRIDES)


MAX_TIMES_RANGE = 30.0
"""Times the range of an axis; a path so large is in another unit."""
MAX_OUTSIDE = 1e-3
"""m; beyond the range of an axis by less is rounding."""


def check_path_in_machine(recordings: Sequence[Recording]) -> None:
    """Refuse a path that the machine cannot drive; InputError states why.

    Axis positions were asked when they were given to the machine, see ``AxisPath.of``.
    """
    for recording in recordings:
        if not isinstance(recording.path, PartsTrack):
            with errors_of(recording.name):
                check_path(recording.path, recording.machine)


def check_path(path: NominalPath, machine: Machine) -> None:
    """Refuse a path that a machine cannot drive; InputError names the unit or the axis."""
    points = path.points
    low, high = points.min(axis=0), points.max(axis=0)
    travel, size = high - low, machine.upper - machine.lower
    reach = np.abs(points).max() / max(np.abs([machine.lower, machine.upper]).max(), 1e-9)
    if max(float(np.max(travel / size)), float(reach)) > MAX_TIMES_RANGE:
        worst = int(np.argmax(travel))
        reached = float(np.abs(points).max())
        unit = unit_hint(reached, float(np.abs([machine.lower, machine.upper]).max())) or 'mm'
        raise InputError(
            f'path: spans {travel[worst]:g} m in {machine.axis_names[worst]} where '
            f'{machine.name} travels {size[worst]:g} m; the path seems to be in '
            f'{unit_words(unit)}, expected m'
        )
    outside = np.maximum(machine.lower - low, high - machine.upper)
    worst = int(np.argmax(outside))
    if outside[worst] > MAX_OUTSIDE:
        raise InputError(
            f'path: leaves the range of axis {machine.axis_names[worst]} by '
            f'{1e3 * outside[worst]:.1f} mm: it spans {low[worst]:g} to {high[worst]:g} m, '
            f'{machine.name} {machine.lower[worst]:g} to {machine.upper[worst]:g} m; do bag and '
            f'machine description belong together?'
        )


CHECKS: tuple[Callable[[Sequence[Recording]], None], ...] = (
    check_same_samples,
    check_path_in_machine,
    check_stamps,
)


def check_recordings(recordings: Sequence[Recording]) -> None:
    """Run all checks; InputError states what is wrong, where, and what to do."""
    for check in CHECKS:
        check(recordings)

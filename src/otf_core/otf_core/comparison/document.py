# SPDX-License-Identifier: Apache-2.0
"""comparison.json: what a comparison of two sources states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.compare import COVERAGE_FACTOR, Comparison, agreement
from otf_core.documents import Document, ResultDocument, optional, stated
from otf_core.model.evaluation import mean_length
from otf_core.model.frames import XYZ
from otf_core.model.motions import unit_of
from otf_core.prediction.absorbed import offset_words

CONVENTION = (
    'positioning and rotations zero at axis position 0, else at the common minimum; straightness '
    'zero at both ends of the common range; squareness contains what this removes from them'
)
LINES = 'location errors contain the least-squares line of the motions of rotary axes'


@dataclass(frozen=True)
class ScalarPair(Document):
    """A squareness or location error of both sources."""

    unit: str = stated('m or rad')
    a: float = stated('of a', 'm or rad')
    b: float = stated('of b', 'm or rad')
    u_a: float = stated('standard uncertainty of a', 'm or rad')
    u_b: float = stated('standard uncertainty of b', 'm or rad')
    normalised_error: float = stated('E_n; null: no uncertainty', unknown=True)


@dataclass(frozen=True)
class MotionPair(Document):
    """An error motion of both sources."""

    unit: str = stated('m or rad')
    position_unit: str = stated('m or rad')
    position: Array = stated('of the axis', 'm or rad', shape=('k',))
    a: Array = stated('of a', 'm or rad', shape=('k',))
    b: Array = stated('of b', 'm or rad', shape=('k',))
    u_a: Array = stated('standard uncertainty of a', 'm or rad', shape=('k',))
    u_b: Array = stated('standard uncertainty of b', 'm or rad', shape=('k',))
    normalised_error: Array = stated('E_n; null: no uncertainty', shape=('k',), unknown=True)
    largest_difference: float = stated('largest of |b - a|', 'm or rad')
    largest_normalised_error: float | None = stated('null: no uncertainty')
    within: float | None = stated('share of E_n up to 1; null: no uncertainty')


@dataclass(frozen=True)
class MeanErrors(Document):
    """Mean lengths of error vectors in the volume."""

    mae_a: float = stated('of a', 'm')
    mae_b: float = stated('of b', 'm')
    mae_difference: float = stated('of b - a', 'm')


@dataclass(frozen=True)
class VolumePair(MeanErrors):
    """Error vectors of both sources, best rigid motion removed."""

    points: int = stated('of the grid')
    holds: tuple[str, ...] = stated('errors that the vectors contain')
    mean_absolute: Mapping[str, float] = stated('of b - a along X, Y and Z', 'm')
    standard_deviation: Mapping[str, float] = stated('of b - a along X, Y and Z', 'm')
    within: float | None = stated('share of E_n up to 1; null: no uncertainty')
    coverage_factor: float = stated('k of the uncertainties in E_n')
    position: Array = stated('nominal place of the target', 'm', shape=('n', 3))
    difference: Array = stated('b - a', 'm', shape=('n', 3))


@dataclass(frozen=True)
class ComparisonDocument(ResultDocument):
    """Two error tables or direct measurements in one convention, and how they agree."""

    file = 'comparison.json'

    a: str = stated('name of the first source')
    b: str = stated('name of the second source')
    machine: str = stated('name of the machine')
    convention: str = stated('gauge of both')
    counted_as_translations: tuple[str, ...] = stated('rotations that one source cannot see')
    without_uncertainty: tuple[str, ...] = stated('which of a and b state no uncertainty')
    translations_apart_by: tuple[str, ...] = stated('rotations that neither source sees')
    not_compared: Mapping[str, str] = stated('other errors, and why')
    target_offsets: tuple[Array, ...] = stated('target offsets of a and b', 'm', shape=(3,))
    remarks: tuple[str, ...] = stated('what has to be known beside the numbers')
    motions: Mapping[str, MotionPair] = stated('error motions that both know')
    squareness: Mapping[str, ScalarPair] = stated('that both know')
    location: Mapping[str, ScalarPair] = stated('that both know')
    volume: VolumePair = stated('differences in the volume')
    volume_with_squareness: MeanErrors | None = optional(
        'the same where all squareness errors are compared'
    )
    schema: str = stated('otf-comparison/2', default='otf-comparison/2')
    provenance: Mapping[str, Any] = stated('when, from what, by what', factory=dict)


def _share(normalised: Array) -> float | None:
    share = agreement(normalised)
    return None if np.isnan(share) else share


def document_of(result: Comparison, provenance: Mapping[str, Any]) -> ComparisonDocument:
    """Return what a comparison states."""
    volume, common = result.volume, result.common
    machine, difference = common.machine, volume.difference
    motions, scalars = dict[str, MotionPair](), dict[str, ScalarPair]()
    for name, pair in result.errors.items():
        columns, normalised = (pair.a, pair.b, pair.u_a, pair.u_b), pair.normalised
        if name in common.scalars:
            numbers = (float(v[0]) for v in (*columns, normalised))
            scalars[name] = ScalarPair(unit_of(name), *numbers)
            continue
        known = normalised[np.isfinite(normalised)]
        motions[name] = MotionPair(
            unit_of(name), machine.axes[name[-1]].unit, pair.position, *columns, normalised,
            float(np.abs(pair.difference).max()), float(known.max()) if known.size else None,
            _share(normalised),
        )  # fmt: skip
    means = MeanErrors(*map(mean_length, (volume.a, volume.b, difference)))
    return ComparisonDocument(
        a=result.names[0],
        b=result.names[1],
        machine=machine.name,
        convention=f'{CONVENTION}; {LINES}' if machine.location else CONVENTION,
        counted_as_translations=tuple(map(str, common.folded)),
        without_uncertainty=result.without_u,
        translations_apart_by=tuple(map(str, common.apart)),
        not_compared=dict(common.not_compared),
        target_offsets=result.offsets,
        remarks=tuple(remarks_on(result)),
        motions=motions,
        squareness={n: v for n, v in scalars.items() if n in machine.squareness},
        location={n: v for n, v in scalars.items() if n in machine.location},
        volume=VolumePair(
            **asdict(means),
            points=len(volume.position),
            holds=tuple(result.errors),
            mean_absolute=dict(zip(XYZ, np.abs(difference).mean(axis=0).tolist(), strict=True)),
            standard_deviation=dict(zip(XYZ, difference.std(axis=0).tolist(), strict=True)),
            within=_share(volume.normalised),
            coverage_factor=COVERAGE_FACTOR,
            position=np.round(volume.position, 6),
            difference=np.round(difference, 10),
        ),
        volume_with_squareness=means if set(machine.squareness) <= set(scalars) else None,
        provenance=provenance,
    )


def remarks_on(result: Comparison) -> list[str]:
    """What has to be known beside the numbers."""
    lines, common = [], result.common
    if common.folded:
        lines.append(
            f'{", ".join(common.folded)}: one source cannot distinguish them from translations; '
            f'treated as such'
        )
    if len(result.without_u) == 1:
        lines.append(f'{result.without_u[0]} states no uncertainty: E_n treats it as exact')
    if common.apart:
        axes = ', '.join(dict.fromkeys(m.axis for m in common.apart))
        lines.append(
            f'WARNING {", ".join(common.apart)}: neither source distinguishes them from '
            f'translations, and the sources measured at different target offsets or places: the '
            f'translations of {axes}, and squareness, differ by these rotations times the '
            f'difference of the levers, regardless of the machine'
        )
    reasons: dict[str, list[str]] = {}
    for name, reason in common.not_compared.items():
        reasons.setdefault(reason, []).append(name)
    lines += [f'not compared: {", ".join(names)}: {why}' for why, names in reasons.items()]
    own, other = result.offsets
    if not np.array_equal(own, other):
        lines.append(
            f'both at the target offset of a, {offset_words(own)}; that of b is '
            f'{offset_words(other)}'
        )
    return lines

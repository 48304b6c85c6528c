# SPDX-License-Identifier: Apache-2.0
"""Cross-coupling: an error that depends on the positions of two or three axes at once.

delta = c u_x^i u_y^j u_z^k e_d with at least two of i, j, k above zero; u is the position scaled
to [-1, 1] over the axis range, so c is the error at the corner of the volume.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import ClassVar

import numpy as np

from otf_core.effects.action import vector
from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms
from otf_core.effects.free import Free
from otf_core.effects.position import scaled_position
from otf_core.model.frames import XYZ

POWERS = (
    *((a, b) for a, b in combinations(range(3), 2)),
    *((a, a, b) for a, b in combinations(range(3), 2)),
    *((a, b, b) for a, b in combinations(range(3), 2)),
    (0, 1, 2),
)
"""Monomials as the axes that are multiplied."""


def _labels(names: tuple[str, ...]) -> list[str]:
    return [_label([names[k] for k in power]) for power in POWERS]


def _label(axes: Sequence[str]) -> str:
    counts = [(a, axes.count(a)) for a in dict.fromkeys(axes)]
    return ''.join(name + (str(count) if count > 1 else '') for name, count in counts)


class CrossCoupling(Effect):
    """Smooth error field that no sum of one-axis functions makes."""

    name: ClassVar[str] = 'cross_coupling'
    cause: ClassVar[str] = (
        'the structure is not rigid: it sags or yaws under the weight of another axis at the '
        'end of its travel'
    )
    equation: ClassVar[str] = 'c u_x^i u_y^j u_z^k e_d, at least two powers above 0'
    coefficients: ClassVar[str] = (
        'c as direction_product, X_XY to Z_XYZ: error along the direction at the corner of the '
        'volume where all positions are at their maximum'
    )
    typical: ClassVar[str] = '1 um on small machines, tens of um on large ones'
    source: ClassVar[str] = (
        'not included in the rigid-body model: Sanders et al., J. Manuf. Mater. Process. 2023, '
        '7, 60, section 1.1'
    )
    signature: ClassVar[str] = 'slope or bend of lines along one axis changes with another axis'
    needs: ClassVar[str] = (
        'lines at several levels of every axis; a second tracker place, since offsets of the '
        'tracker look the same from a single one'
    )
    stays_in_place: ClassVar[bool] = True
    couples: ClassVar[bool] = True

    free: ClassVar[tuple[Free, ...]] = tuple(
        Free(
            pair,
            (4, 4),
            f'the error is not a low-order polynomial of {pair[0].upper()} and {pair[1].upper()}',
            (1, 1),
            vector,
        )
        for pair in combinations('xyz', 2)
    )

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """The coefficient that displaces most."""
        direction, product = fitted.strongest.split('_')
        of = f'along {direction} by {product.replace("2", chr(178))}'
        return (Size(of, ({fitted.strongest: 1.0},), 'm', 'at the corner of the volume'),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return X_XY ... Z_XYZ: direction, then the product of positions."""
        place = scaled_position(state)
        products = np.stack([np.prod(place[:, list(p)], axis=1) for p in POWERS], axis=1)
        columns = np.concatenate([products[:, None, :] * e[:, None] for e in np.eye(3)], axis=2)
        names = tuple(f'{d}_{p}' for d in XYZ for p in _labels(state.machine.axis_names))
        return Terms(names, ('m',) * len(names), tuple(n[0] for n in names), columns)

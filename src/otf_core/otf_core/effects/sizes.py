# SPDX-License-Identifier: Apache-2.0
"""The one size that stands for an effect: what its file makes of the coefficients of a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.model.frames import XYZ
from otf_core.model.machine import Machine

Part = Mapping[str, float]
"""A sum of coefficients: weights by their names."""

MAINLY = 0.9
"""Share of the length of a vector from which one component stands for it."""
SHARE = 0.25
"""Share of the largest displacement by a motion or axis from which its size is stated as well."""


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of an effect in one run, as a fit gives them.

    Attributes
    ----------
    value : mapping of name to float
        SI units.
    reach : mapping of name to float, m per unit
        Root mean square displacement across the path by each.
    axes : tuple of str
        Axes that take part, the strongest first.
    shape : mapping of name to float
    """

    value: Mapping[str, float]
    reach: Mapping[str, float]
    axes: tuple[str, ...]
    shape: Mapping[str, float]
    machine: Machine

    def of(self, part: Part) -> float:
        """A sum of coefficients; those that a fit does not have are zero."""
        return sum(weight * self.value.get(name, 0.0) for name, weight in part.items())

    def displacement(self, name: str) -> float:
        """Root mean square displacement by one coefficient, m."""
        return abs(self.value[name]) * self.reach[name]

    @property
    def strongest(self) -> str:
        """Name of the coefficient that displaces most; '' if there is none."""
        return max(self.value, key=self.displacement, default='')

    def groups(self) -> dict[str, list[str]]:
        """Names by what stands before their last underscore or their @, the strongest first.

        Only those that displace by ``SHARE`` of the strongest.
        """
        by_head: dict[str, list[str]] = {}
        for name in self.value:
            head = name.split('@')[0] if '@' in name else name.rsplit('_', 1)[0]
            by_head.setdefault(head, []).append(name)
        strength = {
            head: float(np.sqrt(sum(self.displacement(n) ** 2 for n in names)))
            for head, names in by_head.items()
        }
        least = SHARE * max(strength.values(), default=0.0)
        relevant = [head for head in by_head if strength[head] >= least]
        return {head: by_head[head] for head in sorted(relevant, key=lambda h: -strength[h])}


@dataclass(frozen=True)
class Size:
    """A size: one sum of coefficients with its sign, or the root of the sum of squares of several.

    Attributes
    ----------
    of : str
        What of the effect it is the size of, as in 'backlash *of X*'; empty for all of it.
    parts : tuple of Part
        Empty for a parameter that is chosen, not estimated.
    unit : str
        SI.
    remark : str
        What kind of size it is, as in 'rms along X'.
    chosen : float
        Its value without parts.
    """

    of: str
    parts: tuple[Part, ...]
    unit: str
    remark: str = ''
    chosen: float = 0.0


def vector_size(
    fitted: Coefficients,
    parts: Sequence[Part],
    unit: str,
    remark: str,
    way: str = '',
    along: str = 'along',
) -> Size:
    """Size of a vector with components X, Y and Z: its main component, else its length.

    Parameters
    ----------
    parts : sequence of Part
        Of the components.
    unit, remark : str
        See ``Size``.
    way : str
        What it does, such as 'shifting'.
    along : str
        'about' for a rotation.
    """
    values = np.array([fitted.of(part) for part in parts])
    main = int(np.argmax(np.abs(values)))
    if abs(values[main]) > MAINLY * float(np.linalg.norm(values)):
        return Size(f'{way} {along} {XYZ[main]}'.lstrip(), (parts[main],), unit, remark)
    return Size(way, tuple(parts), unit, remark)

# SPDX-License-Identifier: Apache-2.0
"""What stands about the reflectors, in machine.yaml under ``surroundings``; for plans alone.

All keys are optional. ``half_angle``: of the cone of beams that a reflector returns. ``boxes``:
bodies by name, edges parallel to X, Y and Z, in the frame of the link that they are fixed to, all
axes at zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.files.strict_yaml import Fields

SMR_ANGLE = math.radians(30.0)
"""rad; half-angle of a spherically mounted reflector."""
LINKS = {'w': 'on the table', 'b': 'on the bed', 't': 'on the tool side'}
LARGEST = 20.0
"""m; boxes lie nearer to the origin of the machine."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """A body: its link and its lowest and highest coordinates, m."""

    link: str
    low: Vector
    high: Vector

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distances (...) of points (..., 3), m; 0 inside."""
        out = np.maximum(np.array(self.low) - points, points - np.array(self.high))
        return np.asarray(np.linalg.norm(np.maximum(out, 0.0), axis=-1))

    def crossed(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether straight lines between points (n, 3), m, run through it, shape (n,)."""
        way = end - start
        way = np.where(np.abs(way) < 1e-12, 1e-12, way)
        near, far = (np.array(self.low) - start) / way, (np.array(self.high) - start) / way
        entry = np.minimum(near, far).max(axis=1)
        leave = np.maximum(near, far).min(axis=1)
        return np.asarray((entry < leave) & (leave > 0.0) & (entry < 1.0))

    @property
    def points(self) -> NDArray[np.float64]:
        """Corners, middles of edges, faces and the body, shape (27, 3), m."""
        low, high = np.array(self.low), np.array(self.high)
        share = np.array(list(product((0.0, 0.5, 1.0), repeat=3)))
        return np.asarray(low + share * (high - low))

    def to_dict(self) -> dict[str, Any]:
        """Layout of machine.yaml."""
        return {'link': self.link, 'low': list(self.low), 'high': list(self.high)}


@dataclass(frozen=True)
class Surroundings:
    """The section; ``half_angle`` in rad."""

    half_angle: float = SMR_ANGLE
    boxes: Mapping[str, Box] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Layout of machine.yaml; empty where nothing is stated."""
        data: dict[str, Any] = {}
        if self.half_angle != SMR_ANGLE:
            data['half_angle'] = self.half_angle
        if self.boxes:
            data['boxes'] = {name: box.to_dict() for name, box in self.boxes.items()}
        return data


def surroundings_from_fields(fields: Fields) -> Surroundings:
    """Read the section.

    Raises
    ------
    ConfigError
        Names the key that is unknown, mistyped or out of range.
    """
    angle = SMR_ANGLE
    if fields.has('half_angle'):
        angle = fields.number('half_angle', low=0.0, high=math.pi, unit='rad', closed=True)
        if angle < math.radians(1.0):
            fields.fail('half_angle', f'{angle:g} rad is less than a degree')
    boxes = {}
    if fields.has('boxes'):
        section = fields.mapping('boxes')
        for name in section.keys:
            boxes[name] = _box(section.mapping(name))
        section.done(known=section.keys)
    fields.done(known=('half_angle', 'boxes'))
    return Surroundings(angle, boxes)


def _box(fields: Fields) -> Box:
    link = fields.text('link')
    if link not in LINKS:
        expected = ', '.join(f"'{k}' ({v})" for k, v in LINKS.items())
        fields.fail('link', f"expected {expected}, got '{link}'")
    low, high = fields.vector('low', 3), fields.vector('high', 3)
    if not all(a < b for a, b in zip(low, high, strict=True)):
        fields.fail('high', f'{high} m is not above low = {low} m in every coordinate')
    if max(map(abs, (*low, *high))) > LARGEST:
        fields.fail('high', f'{low} to {high} m lies outside any machine; is it in mm?')
    fields.done(known=('link', 'low', 'high'))
    return Box(link, (low[0], low[1], low[2]), (high[0], high[1], high[2]))

# SPDX-License-Identifier: Apache-2.0
"""What a plain shape of a gap is: a displacement and its words.

The displacement, in the machine frame, is linear in its coefficients; the words say what it looks
like, not what causes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.diagnosis.place.views import RunView
from otf_core.model.frames import XYZ

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

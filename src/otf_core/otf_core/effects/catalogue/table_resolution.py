# SPDX-License-Identifier: Apache-2.0
"""Table resolution: errors with waves shorter than the tables can follow.

Between two nodes the truth departs from the straight line by
delta = (c 4 s (1 - s) + c' 12 sqrt(3) s (1 - s) (1/2 - s)) J_m(q), s from 0 to 1 between the
nodes; each function reaches 1, J_m is the displacement per unit of the motion. The first is what
a steady curvature leaves, the second what a full wave between two nodes leaves.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import BelongsTo, Coefficients, Effect, Shape, Size, State, Terms
from otf_core.errors import ConfigError
from otf_core.model.chain import Sight
from otf_core.model.motions import ErrorMotion, unit_of

NAME = re.compile(r'(E[XYZABC][XYZ])@(-?[\d.e-]+?)\.\.(-?[\d.e-]+?)(_2)?')
BOW_SQUARE, WAVE_SQUARE = 8.0 / 15.0, 18.0 / 35.0
"""Mean squares of the two functions between two nodes."""


def _label(motion: str, low: float, high: float, wave: bool) -> str:
    return f'{motion}@{low:.6g}..{high:.6g}' + ('_2' if wave else '')


def _bump(q: Array, low: Array | float, high: Array | float, wave: bool) -> Array:
    s = np.clip((q - low) / (high - low), 0.0, 1.0)
    return 12.0 * np.sqrt(3.0) * s * (1 - s) * (0.5 - s) if wave else 4.0 * s * (1 - s)


def _parsed(name: str) -> tuple[ErrorMotion, float, float, bool]:
    where = f'{TableResolution.name}: {name}'
    match = NAME.fullmatch(name)
    if match is None:
        raise ConfigError(f'{where}: unknown; write motion@from..to, m, as in EYX@0.03..0.06')
    symbol, low, high, wave = match.groups()
    try:
        ends = float(low), float(high)
    except ValueError:
        raise ConfigError(f'{where}: {low}..{high} is not an interval') from None
    if not ends[1] > ends[0]:
        raise ConfigError(f'{where}: the interval is empty')
    return ErrorMotion.of(symbol), *ends, wave is not None


class TableResolution(Effect):
    """What motions do between the nodes of their tables."""

    name: ClassVar[str] = 'table_resolution'
    cause: ClassVar[str] = 'nodes too far apart for the waves of a motion'
    equation: ClassVar[str] = (
        "(c 4 s (1 - s) + c' 12 sqrt(3) s (1 - s) (1/2 - s)) J_m(q), s = 0..1 between two nodes"
    )
    coefficients: ClassVar[str] = (
        "c as motion@from..to with the ends of the interval in m, c' with _2 behind it; shape: "
        'order 1 bows, 2 also waves, 3 also rotations'
    )
    typical: ClassVar[str] = '0.5 um to 5 um with nodes 30 mm to 60 mm apart'
    source: ClassVar[str] = (
        'remainder of linear interpolation, h^2 / 8 times the curvature (e.g. Stoer and Bulirsch, '
        'Introduction to Numerical Analysis, section 2.1)'
    )
    signature: ClassVar[str] = (
        'curvature between nodes, at the same axis position on all lines that cross it'
    )
    needs: ClassVar[str] = 'closer table nodes, and lines crossing every interval more than once'
    shape_names: ClassVar[tuple[str, ...]] = ('order',)
    shape_units: ClassVar[tuple[str, ...]] = ('',)
    shape_defaults: ClassVar[Mapping[str, float]] = MappingProxyType({'order': 2.0})
    many_alike: ClassVar[bool] = True
    belongs_to: ClassVar[BelongsTo] = BelongsTo.TABLES
    material_um: ClassVar[float] = 0.45
    """um; smooth errors always leave a little between nodes."""

    def shapes(self, state: State) -> Sequence[Shape]:
        """Order 1: bows of the translations; 2: waves as well; (3: rotations as well)."""
        return ({'order': 1.0}, {'order': 2.0})

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Root mean square between nodes of each motion that displaces much."""
        found_sizes = []
        for head, names in fitted.groups().items():
            intervals = len({n.removesuffix('_2') for n in names})
            square = {n: (WAVE_SQUARE if n.endswith('_2') else BOW_SQUARE) for n in names}
            parts = tuple({n: float(np.sqrt(s / intervals))} for n, s in square.items())
            found_sizes.append(Size(f'of {head}', parts, unit_of(head), 'rms between nodes'))
        return tuple(found_sizes)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return one term per motion and node interval, named by its ends: EYX@0.03..0.06."""
        order = round(shape['order'])
        names: list[str] = []
        moved: list[ErrorMotion] = []
        parts = []
        for motion in (m for m in state.machine.motions if order > 2 or m.is_translation):
            nodes = np.round(state.nodes[motion.axis], 6)
            parts.append((motion, nodes, len(names)))
            pairs = [p for p in pairwise(nodes) for _ in (False, True)[:order]]
            waves = [w for _ in pairwise(nodes) for w in (False, True)[:order]]
            names += [_label(motion, *p, w) for p, w in zip(pairs, waves, strict=True)]
            moved += [motion] * len(pairs)
        columns, row = np.zeros((len(state), 3, len(names))), np.arange(len(state))
        view = Sight.of_tool(state.machine).at(state.q)
        for motion, nodes, start in parts:
            if len(nodes) < 2:
                continue
            influence = view.influence(motion)
            q = state.q[:, state.machine.column(motion.axis)]
            part = np.clip(np.searchsorted(nodes, q, side='right') - 1, 0, len(nodes) - 2)
            for k, wave in enumerate((False, True)[:order]):
                along = _bump(q, nodes[part], nodes[part + 1], wave)
                place = start + part * min(order, 2) + k
                columns[row, :, place] = along[:, None] * influence
        units, axes = tuple(m.unit for m in moved), tuple(m.axis for m in moved)
        return Terms(tuple(names), units, axes, columns)

    def units(self, state: State, parameters: Shape) -> dict[str, str]:
        """Unit of every given parameter; any interval will do, not only those of the nodes."""
        self.complete_shape(parameters)
        own = dict(zip(self.shape_names, self.shape_units, strict=True))
        return {n: own[n] if n in own else unit_of(_parsed(n)[0]) for n in parameters}

    def block_displacement(self, state: State, shape: Shape, parameters: Shape) -> Array:
        """Displacement of a few points for checked parameters, shape (n, 3), m."""
        total = np.zeros((len(state), 3))
        view = Sight.of_tool(state.machine).at(state.q)
        for name in parameters:
            if name not in self.shape_names:
                motion, low, high, wave = _parsed(name)
                along = _bump(state.q[:, state.machine.column(motion.axis)], low, high, wave)
                total += parameters[name] * along[:, None] * view.influence(motion)
        return total

# SPDX-License-Identifier: Apache-2.0
"""Cells of machines with rotary axes, and what they hide.

Nothing; a fault of a rotary axis; play or lag of a linear one; two of either. A fault is as large
as a perfect observer needs who is to see it with ``SMALLEST`` standard deviations, a diagnosis
being expected to find it from ``FOUND`` on, or larger.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.axis_nature import LINEAR, Fault, Nature, Rng
from otf_core.blind.axis_observer import AxisObserver
from otf_core.blind.axis_run import MACHINES, AxisCell, draw_axis_cell
from otf_core.blind.depends import FAULTS

NOTHING, ROTARY_CAUSE, LINEAR_CAUSE, TWO = 'axes_none', 'axes_one', 'axes_linear', 'axes_two'
AXIS_KINDS = {NOTHING: 0.06, ROTARY_CAUSE: 0.08, LINEAR_CAUSE: 0.02, TWO: 0.02}
"""Families, and their shares of the cells of a trial."""
FOUND = 5.0
"""Standard deviations of a perfect observer from which a diagnosis is expected to find a fault."""
SMALLEST, LARGEST = 3.0 * FOUND, 12.0 * FOUND
"""Standard deviations of the faults that are drawn."""
MOST = 25e-6
"""m; no sample is displaced by more."""
DRAWS = 30
"""Draws of a fault until it can be seen well enough."""
AT_INCIDENCE = np.radians(25.0)
"""rad; at which the range error of a reflector is stated."""
OF_ANY = ('play', 'late', 'gear', 'warm', 'brake')
"""Faults that a rotary axis of any machine can have."""
KINDS_OF = {
    'trunnion': (*OF_ANY, 'weight', 'bearing', 'reseating', 'incidence'),
    'rotary': (*OF_ANY, 'reseating'),
    'head': (*OF_ANY, 'reseating'),
}
OF_LINEAR = ('play', 'late')
TURNS = tuple(FAULTS)
"""Faults of rotary axes in the order in which cells hide them."""


@dataclass(frozen=True)
class AxisPart:
    """One hidden fault.

    Attributes
    ----------
    size, raw : float
        m; root mean square per piece of what tables leave, and of the displacement itself.
    snr : float
        Length of what they leave, freed of the noise.
    """

    fault: Fault
    size: float
    raw: float
    snr: float


@dataclass(frozen=True)
class AxisCase:
    """A cell with what it hides."""

    cell: AxisCell
    observer: AxisObserver
    parts: tuple[AxisPart, ...]


def weigh_fault(observer: AxisObserver, fault: Fault) -> AxisPart:
    """Measure a fault."""
    moves = observer.displaced([fault])
    size, snr = observer.left(moves)
    raw = np.sqrt(np.mean(np.concatenate([np.sum(m**2, axis=1) for m in moves])))
    return AxisPart(fault, size, float(raw), snr)


def _unit(rng: Rng, axis: str = '') -> dict[str, float]:
    """Direction across an axis, or any; as ``Fault.vector`` reads it."""
    v = rng.normal(size=3)
    if axis:
        v['XYZABC'.index(axis) % 3] = 0.0
    v /= np.linalg.norm(v)
    return {f'along_{k}': float(x) for k, x in enumerate(v)}


def draw_fault(kind: str, machine: Nature, rng: Rng, axes: str) -> Fault:
    """Draw a fault of some axis among ``axes``, of a typical size."""
    axis = str(rng.choice(list(axes)))
    sign = float(rng.choice((-1.0, 1.0)))
    if kind == 'play':
        return Fault(kind, axis, 1e-5)
    if kind == 'late':
        return Fault(kind, axis, 1e-4)
    if kind == 'gear':
        number = float(rng.choice((24, 30, 36, 40, 45, 48, 60, 72)))
        return Fault(kind, axis, 1e-5, {'number': number, 'phase': float(rng.uniform(0, 6.28))})
    if kind == 'weight':
        angle = rng.uniform(0.0, 2.0 * np.pi)
        return Fault(
            kind, 'A', 1e-5, {'off_0': float(np.cos(angle)), 'off_1': float(np.sin(angle))}
        )
    if kind == 'bearing':
        return Fault(kind, 'C', 1e-5, {'phase': float(rng.uniform(0.0, 6.28))})
    if kind == 'warm':
        tau = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0))))
        return Fault(kind, axis, 1e-5, {'tau': tau, **_unit(rng, axis)})
    if kind == 'brake':
        shape = _unit(rng)
        lean = rng.normal(size=3)
        lean *= rng.uniform(0.0, 8.0) / np.linalg.norm(lean)
        return Fault(
            kind, axis, 5e-6, {**shape, **{f'about_{k}': float(x) for k, x in enumerate(lean)}}
        )
    if kind == 'reseating':
        return Fault(kind, '', 5e-6, _unit(rng))
    return Fault(kind, '', sign * 1e-5, {'power': float(rng.uniform(1.8, 2.2))})


def stated_size(fault: Fault, cell: AxisCell) -> tuple[float, str]:
    """Size of a fault as reports state it, without sign, and its unit.

    Growth while reflectors that the axis moves are in view: nests of a table, or all.
    """
    size = abs(fault.size)
    if fault.kind == 'warm':
        nests = [d for d in cell.driven if d.target.startswith('nest')]
        first, last = (nests or cell.driven)[0].start, cell.driven[-1].length
        tau = fault.shape['tau'] * last
        return size * float(np.exp(-first / tau) - np.exp(-last / tau)), 'm'
    if fault.kind == 'incidence':
        return size * float(AT_INCIDENCE ** fault.shape['power']), 'm'
    if fault.kind == 'play':
        return size, 'm' if fault.axis in LINEAR else 'rad'
    units = {'late': 's', 'gear': 'rad', 'weight': 'rad', 'bearing': 'rad', 'reseating': 'm'}
    return size, units.get(fault.kind, '')


def draw_seen(kind: str, observer: AxisObserver, rng: Rng, axes: str) -> AxisPart | None:
    """Draw a fault that is seen as it should be; None if none of ``DRAWS`` is."""
    wanted = float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))
    for _ in range(DRAWS):
        part = weigh_fault(observer, draw_fault(kind, observer.cell.machine, rng, axes))
        if part.snr <= 0.0:
            continue
        factor = wanted / part.snr
        moves = observer.displaced([part.fault.scaled(factor)])
        if max(float(np.abs(m).max()) for m in moves) < MOST:
            return weigh_fault(observer, part.fault.scaled(factor))
    return None


def draw_axis_case(seed: int, number: int, kind: str, turn: int) -> AxisCase:
    """Draw one cell; ``turn``: how many cells of its kind came before."""
    rng = np.random.default_rng([seed, number + 1])
    while True:
        wanted = _wanted(kind, turn, rng)
        fitting = [m for m in MACHINES if all(w in (*KINDS_OF[m], 'linear') for w in wanted)]
        shares = np.array([MACHINES[m] for m in fitting])
        cell = draw_axis_cell(str(rng.choice(fitting, p=shares / shares.sum())), rng)
        if 'reseating' in wanted and not cell.driven[-1].again:
            continue
        observer, parts = AxisObserver.of(cell), []
        for name in wanted:
            linear = name == 'linear'
            one = str(rng.choice(OF_LINEAR)) if linear else name
            axes = LINEAR if linear else ''.join(cell.machine.turning)
            parts.append(draw_seen(one, observer, rng, axes))
        if all(parts):
            return AxisCase(cell, observer, tuple(p for p in parts if p))


def _wanted(kind: str, turn: int, rng: Rng) -> list[str]:
    """Faults to hide; 'linear' for one of a linear axis."""
    if kind == NOTHING:
        return []
    if kind == ROTARY_CAUSE:
        return [TURNS[turn % len(TURNS)]]
    if kind == LINEAR_CAUSE:
        return ['linear']
    return [str(n) for n in rng.choice(TURNS, 2, replace=False)]


def _entry(part: AxisPart, cell: AxisCell) -> dict[str, Any]:
    value, unit = stated_size(part.fault, cell)
    fault = part.fault
    return {
        'effect': FAULTS[fault.kind],
        'names': [FAULTS[fault.kind]],
        'axes': [fault.axis] if fault.axis else [],
        'depends': {'groups': [], 'besides': []},
        'parameters': {'size': fault.size, **fault.shape},
        'stated': {'value': value, 'unit': unit},
        'size_um': 1e6 * part.size,
        'raw_um': 1e6 * part.raw,
        'snr': part.snr,
    }


def axis_entry(case: AxisCase) -> Mapping[str, Any]:
    """What the key says about a cell with rotary axes, beside its number and kind."""
    cell = case.cell
    return {
        'parts': [_entry(p, cell) for p in case.parts],
        'first_place_only': [],
        'measured_um': None,
        'simulated_um': None,
        'bends_um': 0.0,
        'chain': cell.machine.spec['chain'],
        'places': 1,
        'duration': cell.driven[-1].length,
        'feeds': sorted({round(float(p.feed), 4) for p in cell.parts}),
        'heavy_tails': False,
    }


def seen_positions(case: AxisCase) -> list[Array]:
    """Where the tracker sees the reflectors, with all that is hidden, part by part, m."""
    faults = [p.fault for p in case.parts]
    together = case.observer.displaced(faults)
    return [a + b for a, b in zip(case.observer.plain, together, strict=True)]

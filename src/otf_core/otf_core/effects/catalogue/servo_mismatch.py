# SPDX-License-Identifier: Apache-2.0
"""Servo mismatch: axes that follow their command with different delays.

delta = -v T_a d_a e_a, added over the axes a; T_a = 1/Kv_a is the delay of the axis, v d the
velocity. Equal delays of all axes shift the point along the path and leave no trace across it.
"""

from __future__ import annotations

from typing import ClassVar

from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms
from otf_core.effects.free import Free
from otf_core.model.machine import BED, Machine


def _moves_with(machine: Machine, axis: str) -> str:
    """What moves at the same time as an axis, in words.

    A tracker on the bed sees the axes of the table together, or those of the tool.
    """
    side = machine.chain.table_side if axis in machine.chain.table_side else ()
    others = [a for a in side if a != axis]
    if machine.tracker.link == BED and len(others) == 1:
        return others[0]
    return 'what moves with it'


class ServoMismatch(Effect):
    """Following error that is not the same in all axes."""

    name: ClassVar[str] = 'servo_mismatch'
    cause: ClassVar[str] = 'position loops of different gain Kv: each axis lags by v / Kv'
    equation: ClassVar[str] = '-v T_a d_a e_a'
    coefficients: ClassVar[str] = 'T_a: delay of axis a; only differences between axes are visible'
    typical: ClassVar[str] = '0.01 ms to 0.1 ms between axes: 2 um to 20 um at 12 m/min'
    source: ClassVar[str] = (
        'HEIDENHAIN TNC 430 technical manual (Kv factor; equal for axes that interpolate)'
    )
    signature: ClassVar[str] = (
        'offset on every diagonal that changes sign with the direction of travel and grows with '
        'the feed'
    )
    needs: ClassVar[str] = 'two feeds, forward and backward; at one feed it looks like backlash'
    any_axes: ClassVar[bool] = True

    free: ClassVar[tuple[Free, ...]] = (
        Free(('feed',), (2,), 'the lag is not proportional to the feed'),
        Free(('since_stop',), (5,), 'the lag changes during a leg'),
        Free(
            ('since_stop', 'feed'),
            (5, 2),
            'the lag changes during a leg and is not proportional to the feed',
        ),
    )

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Largest difference of the delays of two axes, or the one that takes part."""
        if fitted.machine.rotary_names and len(fitted.axes) == 1:
            (axis,) = fitted.axes
            other = _moves_with(fitted.machine, axis)
            if fitted.of({f'T_{axis}': 1.0}) < 0.0:
                return (Size(f'of {other} behind {axis}', ({f'T_{axis}': -1.0},), 's'),)
            return (Size(f'of {axis} behind {other}', ({f'T_{axis}': 1.0},), 's'),)
        delays = {a: fitted.of({f'T_{a}': 1.0}) for a in fitted.machine.axis_names}
        late, early = max(delays, key=delays.__getitem__), min(delays, key=delays.__getitem__)
        return (Size(f'of {late} behind {early}', ({f'T_{late}': 1.0, f'T_{early}': -1.0},), 's'),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return T_X, T_Y, T_Z, and those of rotary axes."""
        axes = state.machine.axis_names
        names = tuple(f'T_{a}' for a in axes)
        return Terms(names, ('s',) * len(axes), axes, state.by_axes(-state.velocity))

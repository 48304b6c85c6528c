# SPDX-License-Identifier: Apache-2.0
"""Signals of a simulated cell: a load that is switched on and off, and what warms up by it.

A state is 0 or 1; a temperature, pressure or humidity follows the load with a lag of first order
over ``RANGES``, or over the range that an effect states.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.effects import AppliedEffect
from otf_core.effects.free_form import FreeForm
from otf_core.errors import ConfigError
from otf_core.model.machine import Machine
from otf_core.model.sections import SIGNAL_FIELDS, SIGNAL_PREFIX, USUAL_SIGNAL, SignalSpec
from otf_core.model.signals import Signal, first_order_response

STEP = 1.0
"""s; between messages."""
SHARES = (0.08, 0.45, 0.65, 0.9)
"""Of the run: the load is switched at about these, on first."""
FOLLOWS = 0.12
"""Time constant of what follows the load, over the duration."""
RANGES = {
    'sensor_msgs/msg/Temperature': (20.0, 26.0),
    'sensor_msgs/msg/FluidPressure': (1.0e5, 1.01e5),
    'sensor_msgs/msg/RelativeHumidity': (0.4, 0.5),
}
"""Smallest and largest value by the type of the messages; 0 and 1 of all others."""


def simulated_signals(
    machine: Machine,
    effects: Sequence[AppliedEffect],
    duration: float,
    start_ns: int,
    rng: np.random.Generator,
) -> dict[SignalSpec, Signal]:
    """Signals that the machine declares with a type, and those that effects follow.

    Raises
    ------
    ConfigError
        If an effect follows a signal whose messages are not known.
    """
    ranges = _followed(effects)
    specs = {s.wanted: s for s in machine.signals if s.type}
    for wanted in ranges:
        if wanted not in specs:
            specs[wanted] = _undeclared(wanted)
    time = np.arange(0.0, duration + STEP, STEP)
    stamps = start_ns + np.rint(1e9 * time).astype(np.int64)
    signals = {}
    for wanted, spec in specs.items():
        course = _load(time / max(duration, STEP), rng)
        if spec.type in RANGES:
            course = first_order_response(time, course, FOLLOWS * duration)
        low, high = ranges.get(wanted) or RANGES.get(spec.type, (0.0, 1.0))
        signals[spec] = Signal(stamps, low + (high - low) * course)
    return signals


def _followed(effects: Sequence[AppliedEffect]) -> dict[str, tuple[float, float]]:
    """Ranges that effects state for the signals that they follow, by topic and field."""
    return {
        name.removeprefix(SIGNAL_PREFIX).partition('@')[0]: span
        for one in effects
        if isinstance(one.effect, FreeForm)
        for name, span in one.effect.spans.items()
        if name.startswith(SIGNAL_PREFIX)
    }


def _undeclared(wanted: str) -> SignalSpec:
    topic, _, field = wanted.partition(':')
    kinds = [k for k, own in SIGNAL_FIELDS.items() if own == field] if field else [USUAL_SIGNAL]
    if not kinds:
        raise ConfigError(
            f'{SIGNAL_PREFIX}{wanted}: the form of its messages is unknown; declare it under '
            f'signals in machine.yaml'
        )
    return SignalSpec(topic, field, '', kinds[0], ())


def _load(share: Array, rng: np.random.Generator) -> Array:
    """1 where the load is on, at shares of the run."""
    at = np.array(SHARES) + rng.uniform(-0.04, 0.04, len(SHARES))
    return (np.searchsorted(at, share, side='right') % 2).astype(float)

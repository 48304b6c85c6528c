# SPDX-License-Identifier: Apache-2.0
"""Signals that arrive beside the samples: kept, and given out for a run."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from otf_core.bags.signals import MIN_MESSAGES, signal_of
from otf_core.model.declared_signals import SignalSpec
from otf_core.model.observation import Samples
from otf_core.model.signals import Signal

MOST = 200_000
"""Values of each signal that are kept."""
BEFORE, AFTER = 1800 * 10**9, 10 * 10**9
"""ns; what was measured so long before and after the samples is theirs: what warms up follows
its temperature with a lag."""


class Beside:
    """Values of declared signals, as they arrive."""

    def __init__(self, specs: Sequence[SignalSpec] = ()) -> None:
        self.specs = tuple(specs)
        self._values: dict[SignalSpec, deque[tuple[int, float]]] = {
            spec: deque(maxlen=MOST) for spec in self.specs
        }

    def add(self, spec: SignalSpec, stamp_ns: int, value: float) -> None:
        """Take one value; what is no number is left out."""
        if math.isfinite(value):
            self._values[spec].append((stamp_ns, value))

    def of(self, samples: Samples) -> dict[SignalSpec, Signal]:
        """Signals around the time of samples, those with enough values."""
        if not len(samples):
            return {}
        first, last = int(samples.stamp_ns.min()) - BEFORE, int(samples.stamp_ns.max()) + AFTER
        near = {
            spec: {s: v for s, v in tuple(own) if first <= s <= last}
            for spec, own in self._values.items()
        }
        return {
            spec: signal_of(spec.wanted, list(own.items()))
            for spec, own in near.items()
            if len(own) >= MIN_MESSAGES
        }

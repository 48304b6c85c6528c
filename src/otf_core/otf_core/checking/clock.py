# SPDX-License-Identifier: Apache-2.0
"""Stamps of the tracker against the clock of the computer that recorded them.

Calibration uses the stamps alone, and of them the intervals; a clock that runs at another rate
does no harm. One that was set while it recorded does, and so do stamps that are no times of
measurement.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.bag_reading import Received
from otf_core.checking.checked import Check, Checked, errors, warnings
from otf_core.checking.seen import Seen
from otf_core.model.provenance import moment

SET = 0.3
"""s; a lasting change between both clocks that no transport explains."""
AROUND = 50
"""Samples on either side over which the difference of the clocks is taken."""
JITTER = 0.5
"""Usual deviation of an interval from the median, over it, from which on stamps are doubtful."""


def _ask(seen: Seen) -> Checked:
    samples = seen.samples
    if seen.received is None or samples is None or len(samples) < 2 * AROUND:
        return Checked(problems=errors(seen.why('stamps')))
    first = moment(int(samples.stamp_ns[0]))
    words = f'starts {first}' if first else 'stamps count from an epoch of their own'
    steps = _set(seen.received)
    said = ''
    if len(steps):
        said = (
            f'the clock of the stamps was set {len(steps)} times against that of the recorder, '
            f'first {steps[0]:.1f} s after the start: let the driver stamp with a clock that '
            f'nobody sets'
        )
    step = np.diff(samples.stamp_ns)
    jitter = float(np.median(np.abs(step - np.median(step))) / np.median(step))
    uneven = ''
    if jitter > JITTER:
        uneven = (
            f'intervals of the stamps scatter by {100 * jitter:.0f} %, as times of arrival do: '
            f'let the driver stamp the moment of measurement'
        )
    return Checked(
        f'{words}, intervals scatter by {100 * jitter:.1f} %',
        {'first_stamp': first, 'clock_set': len(steps), 'jitter': jitter},
        errors(seen.why('stamps')) + warnings(said, uneven),
    )


def _set(received: Received) -> NDArray[np.float64]:
    """Moments at which the difference of both clocks jumps and stays, s since the start."""
    late = 1e-9 * (received.log_time - received.stamp_ns)
    late -= late[0]
    jump = np.flatnonzero(np.abs(np.diff(late)) > SET)
    jump = jump[(jump >= AROUND) & (jump < len(late) - AROUND)]
    stays = [
        k for k in jump.tolist()
        if abs(np.median(late[k + 1 : k + AROUND]) - np.median(late[k - AROUND : k + 1])) > SET
    ]  # fmt: skip
    return np.asarray(1e-9 * (received.log_time[stays] - received.log_time[0]))


CLOCK = Check('clock', _ask)

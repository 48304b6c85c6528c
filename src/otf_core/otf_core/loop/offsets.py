# SPDX-License-Identifier: Apache-2.0
"""HAL component: external offsets that take the volumetric error off at the present position.

Runs under the Python of the system, where the module ``hal`` is; reads the neutral lattice
(errors in m) and sets counts of 10 nm. Evaluated where the target will be in half a period of
its own; the speed is that between the last two readings. A correction beyond ``MAX_OFFSET``, or a
reading delayed by more than ``MAX_DELAY``, holds the feed and is reported on stderr.
"""

import bisect
import sys
import time
from typing import Any, TypeAlias

import hal  # type: ignore[import-not-found]

Row: TypeAlias = list[float]
Table: TypeAlias = dict[tuple[int, ...], tuple[float, ...]]

COUNT = 1e-8
"""m"""
MAX_OFFSET = 1e-3
"""m"""
MAX_DELAY = 0.25
"""s"""
PERIOD = 0.001
"""s"""
LEAD_TIME = 0.003
"""s; from reading a position to the offset in the motors: planner of the offsets included."""


def read_lattice(name: str) -> tuple[list[Row], Table]:
    """Axes (three lists, m) and errors by index of plane."""
    rows = []
    with open(name, encoding='utf-8') as file:
        for line in file:
            if line[0] not in '#x':
                rows.append([float(word) for word in line.split(',')])
    axes = [sorted({row[k] for row in rows}) for k in range(3)]
    place = [{v: i for i, v in enumerate(axis)} for axis in axes]
    table: Table = {}
    for row in rows:
        table[tuple(place[k][row[k]] for k in range(3))] = tuple(row[3:6])
    return axes, table


def cell(axis: Row, q: float) -> tuple[int, float]:
    """Lower plane and share of the interval; held constant outside."""
    i = min(max(bisect.bisect_right(axis, q) - 1, 0), len(axis) - 2)
    share = (q - axis[i]) / (axis[i + 1] - axis[i])
    return i, min(max(share, 0.0), 1.0)


def error_at(axes: list[Row], table: Table, q: Row) -> Row:
    """Trilinear error, m."""
    (i, u), (j, v), (k, w) = (cell(axis, value) for axis, value in zip(axes, q, strict=True))
    total = [0.0, 0.0, 0.0]
    for a, x in ((0, 1 - u), (1, u)):
        for b, y in ((0, 1 - v), (1, v)):
            for c, z in ((0, 1 - w), (1, w)):
                error = table[i + a, j + b, k + c]
                for n in range(3):
                    total[n] += x * y * z * error[n]
    return total


def component() -> Any:
    """Make the component with its pins."""
    pins = hal.component('otf-volume')
    for axis in 'xyz':
        pins.newpin(f'believed-{axis}', hal.HAL_FLOAT, hal.HAL_IN)
        pins.newpin(f'offset-{axis}', hal.HAL_FLOAT, hal.HAL_IN)
        pins.newpin(f'counts-{axis}', hal.HAL_S32, hal.HAL_OUT)
        pins.newpin(f'on-{axis}', hal.HAL_BIT, hal.HAL_OUT)
    pins.newpin('fault', hal.HAL_BIT, hal.HAL_OUT)
    pins.newpin('slowest', hal.HAL_FLOAT, hal.HAL_OUT)
    return pins


def look(
    component: Any, axes: list[Row], table: Table, last: tuple[Row, float] | None
) -> tuple[Row, float]:
    """Set the offsets once; return position and time of this look."""
    now = time.monotonic()
    q = [1e-3 * (component[f'believed-{a}'] - component[f'offset-{a}']) for a in 'xyz']
    ahead = q
    if last is not None:
        before, then = last
        step = now - then
        component['slowest'] = max(component['slowest'], step)
        if step > MAX_DELAY and q != before:
            component['fault'] = True
            sys.stderr.write(f'otf-volume: position read {step:.3f} s late at {q}: feed held\n')
        if 0 < step < MAX_DELAY:
            ahead = [b + (b - a) * LEAD_TIME / step for a, b in zip(before, q, strict=True)]
    error = error_at(axes, table, ahead)
    if max(map(abs, error)) > MAX_OFFSET:
        component['fault'] = True
        sys.stderr.write(f'otf-volume: correction {error} m beyond {MAX_OFFSET} m: feed held\n')
    else:
        for axis, value in zip('xyz', error, strict=True):
            component[f'counts-{axis}'] = round(-value / COUNT)
    return q, now


def main() -> None:
    """Look at the position until LinuxCNC ends the component."""
    axes, table = read_lattice(sys.argv[1])
    pins = component()
    for axis in 'xyz':
        pins[f'on-{axis}'] = True
    pins.ready()
    last: tuple[Row, float] | None = None
    try:
        while True:
            last = look(pins, axes, table, last)
            time.sleep(PERIOD)
    except KeyboardInterrupt:
        pass


if __name__ == '__main__':
    main()

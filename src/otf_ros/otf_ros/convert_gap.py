# SPDX-License-Identifier: Apache-2.0
"""A diagnosis as plain data (gap.json) to its message: the same content, in SI units."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from builtin_interfaces.msg import Time

from otf_msgs.msg import GapCause, GapPlace, GapReport
from otf_ros.convert import header

UM = 1e-6
GROUPING = 'by_'
"""Begins the names of the lists of places in gap.json."""


def gap_to_message(data: Mapping[str, Any], stamp: Time) -> GapReport:
    """Return the report of a diagnosis; run, machine and folder are left empty.

    Parameters
    ----------
    data : mapping
        In the layout of gap.json.
    """
    gap, unexplained, where = data['gap'], data['unexplained'], data['where']
    low, high = gap['shrink_interval_percent']
    smallest = data['smallest_found_um']
    return GapReport(
        header=header(stamp),
        status=GapReport.OK,
        message=data['sentence'],
        runs=list(data['runs']),
        verdict=data['verdict'],
        measured=UM * gap['measured_um'],
        simulated=UM * gap['simulated_um'],
        gap_before=UM * gap['before_um'],
        gap_after=UM * gap['after_um'],
        shrink=gap['shrink_percent'] / 100,
        shrink_low=low / 100,
        shrink_high=high / 100,
        causes=[_cause(cause) for cause in data['causes']],
        table_change=UM * data['table_change_um'],
        unexplained=UM * unexplained['rms_um'],
        unexplained_where=unexplained['where'],
        not_visible=[hidden['effect'] for hidden in data['not_visible']],
        not_visible_needs=[hidden['needs'] for hidden in data['not_visible']],
        where=where['summary'],
        places=list(_places(where)),
        considered=[rival['effect'] for rival in data['considered']],
        log_odds=[rival['log_odds'] for rival in data['considered']],
        effects=list(smallest),
        smallest_found=[UM * size for size in smallest.values()],
    )


def gap_failure_to_message(exit_code: int, text: str, stamp: Time) -> GapReport:
    """Return the report of a diagnosis that gave none."""
    return GapReport(header=header(stamp), status=exit_code, message=text)


def _cause(cause: Mapping[str, Any]) -> GapCause:
    names = list(cause['parameters'])
    return GapCause(
        effect=cause['effect'],
        axes=list(cause['axes']),
        parameter=names,
        value=[float(cause['parameters'][name]) for name in names],
        u=[float(cause['u'].get(name, math.nan)) for name in names],
        unit=[cause['units'][name] for name in names],
        gap_before=UM * cause['before_um'],
        gap_after=UM * cause['after_um'],
        shrink=cause['shrink_percent'] / 100,
        confidence=float(cause['confidence']),
        indistinguishable_from=list(cause['indistinguishable_from']),
    )


def _places(where: Mapping[str, Any]) -> Iterator[GapPlace]:
    for name, rows in where.items():
        if not name.startswith(GROUPING):
            continue
        for row in rows:
            place = GapPlace(
                grouping=name.removeprefix(GROUPING),
                kind=row['kind'],
                label=row['label'],
                measured=UM * row['rms_um'],
                expected=UM * row['expected_um'],
                significance=float(row['significance']),
                pieces=row['pieces'],
                legs=row['legs'],
                leg=row.get('leg', -1),
            )
            if place.leg >= 0:
                _add_leg(place, row)
            yield place


def _add_leg(place: GapPlace, row: Mapping[str, Any]) -> None:
    place.time = row['time']
    for point, name in ((place.start, 'from'), (place.end, 'to')):
        point.x, point.y, point.z = row[name][
            :3
        ]  # of a machine with rotary axes their angles follow
    place.mean.x, place.mean.y, place.mean.z = (UM * part for part in row['mean_um'])

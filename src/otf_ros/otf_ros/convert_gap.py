# SPDX-License-Identifier: Apache-2.0
"""A diagnosis as plain data (gap.json) to its message: the same content, in SI units."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3

from otf_msgs.msg import GapCause, GapPlace, GapReport
from otf_ros.convert import header

SI = {'_um': 1e-6, '_percent': 1e-2}
"""Factor to SI units by the end of a name, which the fields of the messages lack."""
GROUPING = 'by_'
"""Begins the names of the lists of places in gap.json."""


def _si(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return numbers in SI units, under names without a unit, and all else as it is."""
    found = {}
    for name, value in data.items():
        end = next((end for end in SI if name.endswith(end)), '')
        array = np.multiply(value, SI[end]).tolist() if end else value
        found[name.removesuffix(end)] = array
    return found


def _fields(kind: Any, data: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a message that data have under the same name, in SI units."""
    known = kind.get_fields_and_field_types()
    return {
        name: float(value) if known[name] == 'double' else value
        for name, value in _si(data).items()
        if name in known
    }


def gap_to_message(data: Mapping[str, Any], stamp: Time) -> GapReport:
    """Return the report of a diagnosis; run, machine and folder are left empty.

    Parameters
    ----------
    data : mapping
        In the layout of gap.json.
    """
    gap, unexplained, where = _si(data['gap']), data['unexplained'], data['where']
    smallest, hidden, considered = (
        data[name] for name in ('smallest_found_um', 'not_visible', 'considered')
    )
    return GapReport(
        header=header(stamp),
        status=GapReport.OK,
        message=data['sentence'],
        runs=list(data['runs']),
        verdict=data['verdict'],
        **_fields(GapReport, data['gap']),
        gap_before=gap['before'],
        gap_after=gap['after'],
        shrink_low=gap['shrink_interval'][0],
        shrink_high=gap['shrink_interval'][1],
        causes=[_cause(cause) for cause in data['causes']],
        table_change=SI['_um'] * data['table_change_um'],
        unexplained=_si(unexplained)['rms'],
        unexplained_where=unexplained['where'],
        not_visible=[one['effect'] for one in hidden],
        not_visible_needs=[one['needs'] for one in hidden],
        where=where['summary'],
        places=list(_places(where)),
        considered=[rival['effect'] for rival in considered],
        log_odds=[rival['log_odds'] for rival in considered],
        effects=list(smallest),
        smallest_found=[SI['_um'] * size for size in smallest.values()],
    )


def gap_failure_to_message(exit_code: int, text: str, stamp: Time) -> GapReport:
    """Return the report of a diagnosis that gave none."""
    return GapReport(header=header(stamp), status=exit_code, message=text)


def _cause(cause: Mapping[str, Any]) -> GapCause:
    names, si = list(cause['parameters']), _si(cause)
    given = {k: v for k, v in cause.items() if k != 'u'}  # there by the names of parameters
    return GapCause(
        **_fields(GapCause, given),
        parameter=names,
        value=[float(cause['parameters'][name]) for name in names],
        u=[float(cause['u'].get(name, math.nan)) for name in names],
        unit=[cause['units'][name] for name in names],
        gap_before=si['before'],
        gap_after=si['after'],
    )


def _places(where: Mapping[str, Any]) -> Iterator[GapPlace]:
    for name, rows in where.items():
        for row in rows if name.startswith(GROUPING) else ():
            si = _si(row)
            mean = si.pop('mean', (0.0, 0.0, 0.0))
            leg = {'start': si.pop('from', ()), 'end': si.pop('to', ())}
            place = GapPlace(
                **_fields(GapPlace, {'leg': -1, **si}),
                grouping=name.removeprefix(GROUPING),
                measured=si['rms'],
            )
            if place.leg >= 0:
                # of a machine with rotary axes their angles follow
                place.start, place.end = (Point(**_xyz(p)) for p in leg.values())
                place.mean = Vector3(**_xyz(mean))
            yield place


def _xyz(values: Sequence[float]) -> dict[str, float]:
    return dict(zip('xyz', values, strict=False))

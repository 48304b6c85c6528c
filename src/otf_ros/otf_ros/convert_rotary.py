# SPDX-License-Identifier: Apache-2.0
"""Results of a calibration of a machine with rotary axes to messages."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3

from otf_core.arrays import Array
from otf_core.calibration.axis_calibration import AxisCalibration, first_pose, volume_errors
from otf_core.reports.rotary_calibration import verdicts_of
from otf_msgs.msg import CalibrationResult as ResultMessage
from otf_msgs.msg import ErrorTables as TablesMessage
from otf_msgs.msg import TargetPlace
from otf_ros.convert_result import (
    Messages,
    alignment_to_message,
    common_result,
    tables_to_message,
    volume_to_message,
)


def messages_of(
    result: AxisCalibration, stamp: Time, method: str, *, provisional: bool = False
) -> Messages:
    """Return all messages of a calibration; see ``convert_result.messages_of``."""
    return Messages(
        _tables(result, stamp, method),
        alignment_to_message(first_pose(result), stamp),
        _result(result, stamp, method),
        volume_to_message(volume_errors(result, provisional), result.run_id, stamp),
    )


def summary(result: AxisCalibration) -> str:
    """Return the outcome in one sentence."""
    verdicts, first = verdicts_of(result), result.headline
    if not verdicts.good:
        return verdicts.measurement_words
    return '; '.join(
        [
            first.error_words,
            first.expanded_words,
            verdicts.measurement_words,
            verdicts.machine_words,
        ]
    )


def _tables(result: AxisCalibration, stamp: Time, method: str) -> TablesMessage:
    """All errors of one calibration."""
    machine, hidden = result.machine, result.made.hidden
    location = {name: result.tables.location[name] for name in machine.location}
    message = tables_to_message(result, first_pose(result), hidden, stamp, method)
    message.location = list(location)
    message.location_value = [entry.value for entry in location.values()]
    message.location_u = [entry.u for entry in location.values()]
    message.location_identifiable = [entry.identifiable for entry in location.values()]
    message.targets = [
        TargetPlace(
            name=name,
            link=machine.targets[name].link,
            place=Point(**_xyz(place)),
            u=Vector3(**_xyz(u)),
        )
        for name, (place, u) in result.targets.items()
    ]
    return message


def _result(result: AxisCalibration, stamp: Time, method: str) -> ResultMessage:
    """Summary; what only the node knows (lost samples, folder) is left empty."""
    hidden = result.made.hidden
    location = {name: result.tables.location[name] for name in result.machine.location}
    message = common_result(result, verdicts_of(result), first_pose(result), hidden, stamp, method)
    message.message = summary(result)
    message.coverage = min(1.0, result.fit.coverage)
    message.location = list(location)
    message.location_value = [entry.value for entry in location.values()]
    message.location_u = [
        entry.u if entry.identifiable else math.nan for entry in location.values()
    ]
    message.needs = [result.advice.get(name, '') for name in hidden]
    return message


def _xyz(values: Array) -> dict[str, float]:
    return dict(zip('xyz', values.tolist(), strict=True))

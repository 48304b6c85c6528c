# SPDX-License-Identifier: Apache-2.0
"""What is published of a calibration, of machines with linear axes alone and with rotary ones."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from typing import Any

from builtin_interfaces.msg import Time

from otf_calibrator.children import AnyCalibration
from otf_core.arrays import Array
from otf_core.calibration.axis_calibration import AxisCalibration
from otf_core.calibration.first_sight import FirstSight
from otf_ros import convert_result, convert_rotary
from otf_ros.convert_result import Messages


def messages_of(
    result: AnyCalibration, stamp: Time, method: str, *, provisional: bool = False
) -> Messages:
    """All messages of a calibration."""
    if isinstance(result, AxisCalibration):
        return convert_rotary.messages_of(result, stamp, method, provisional=provisional)
    return convert_result.messages_of(result, stamp, method, provisional=provisional)


def summary(result: AnyCalibration) -> str:
    """The outcome in one sentence."""
    if isinstance(result, AxisCalibration):
        return convert_rotary.summary(result)
    return convert_result.summary(result)


def places_of(job: Future[Any]) -> Mapping[str, Array] | None:
    """Where a calibration or a look found the reflectors; None if it tells nothing of them."""
    if job.exception():
        return None
    found = job.result()
    if isinstance(found, FirstSight):
        return found.places
    if not isinstance(found.result, AxisCalibration):
        return None
    return {name: place for name, (place, _) in found.result.targets.items()}

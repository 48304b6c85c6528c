# SPDX-License-Identifier: Apache-2.0
"""Results of a calibration of a machine with rotary axes to messages."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3

from otf_core.arrays import Array
from otf_core.calibration.calibration_result import motion_sizes
from otf_core.model.expanded import COVERAGE_FACTOR, micro_with_expanded
from otf_core.reports.rotary_calibration import verdicts_of, volume_sizes
from otf_core.rotary.axis_calibration import AxisCalibration, first_pose
from otf_core.rotary.axis_volume import volume_errors
from otf_core.version import __version__
from otf_msgs.msg import CalibrationResult as ResultMessage
from otf_msgs.msg import ErrorTables as TablesMessage
from otf_msgs.msg import TargetPlace
from otf_ros.convert import header, time_from_ns, transform_to_message
from otf_ros.convert_result import (
    MACHINE_STATES,
    Messages,
    alignment_to_message,
    tables_to_messages,
    volume_to_message,
)


def messages_of(
    result: AxisCalibration, stamp: Time, method: str, *, provisional: bool = False
) -> Messages:
    """Return all messages of a calibration; see ``convert_result.messages_of``."""
    tables = tables_to_messages(result.tables, result.run_id, stamp)
    together = _together(result, stamp, method)
    together.tables = list(tables.values())
    return Messages(
        tables,
        together,
        alignment_to_message(first_pose(result), stamp),
        _result(result, stamp, method),
        volume_to_message(volume_errors(result, provisional), result.run_id, stamp),
    )


def summary(result: AxisCalibration) -> str:
    """Return the outcome in one sentence."""
    verdicts, size = verdicts_of(result), volume_sizes(result)
    if not verdicts.good:
        return verdicts.measurement_words
    error = micro_with_expanded(size['mean'], COVERAGE_FACTOR * result.made.grid_u)
    words = f'mean volumetric error over the driven ranges of all axes {error}'
    return '; '.join([words, verdicts.measurement_words, verdicts.machine_words])


def _together(result: AxisCalibration, stamp: Time, method: str) -> TablesMessage:
    """All errors of one calibration but the tables of the motions."""
    machine, run, hidden = result.machine, result.origin[0], result.made.hidden
    square = {name: result.tables.squareness[name] for name in machine.squareness}
    location = {name: result.tables.location[name] for name in machine.location}
    targets = [
        TargetPlace(
            name=name,
            link=machine.targets[name].link,
            place=Point(**_xyz(place)),
            u=Vector3(**_xyz(u)),
        )
        for name, (place, u) in result.targets.items()
    ]
    return TablesMessage(
        header=header(stamp),
        run_id=result.run_id,
        machine=machine.name,
        chain=str(machine.chain),
        method=method,
        passed=not result.failed_gates,
        squareness=list(square),
        squareness_value=[entry.value for entry in square.values()],
        squareness_u=[entry.u for entry in square.values()],
        squareness_identifiable=[name not in hidden for name in square],
        location=list(location),
        location_value=[entry.value for entry in location.values()],
        location_u=[entry.u for entry in location.values()],
        location_identifiable=[entry.identifiable for entry in location.values()],
        targets=targets,
        tracker_link=machine.tracker.link,
        alignment=transform_to_message(first_pose(result)),
        software=f'otf_core {__version__}',
        first=time_from_ns(run.first_ns),
        last=time_from_ns(run.last_ns),
        samples=run.samples,
        run_sha256=run.sha256,
        machine_sha256=machine.file_sha256,
    )


def _result(result: AxisCalibration, stamp: Time, method: str) -> ResultMessage:
    """Summary; what only the node knows (lost samples, folder) is left empty."""
    fit, machine, verdicts = result.fit, result.machine, verdicts_of(result)
    sizes, size = motion_sizes(result.tables), volume_sizes(result)
    location = {name: result.tables.location[name] for name in machine.location}
    message = ResultMessage(
        header=header(stamp),
        run_id=result.run_id,
        status=verdicts.exit_code,
        message=summary(result),
        machine=machine.name,
        chain=str(machine.chain),
        method=method,
        measurement_good=verdicts.good,
        measurement_verdict=verdicts.measurement_words,
        machine_state=MACHINE_STATES[verdicts.machine_state],
        machine_verdict=verdicts.machine_words,
        volumetric_error_mean=size['mean'],
        volumetric_error_largest=size['max'],
        expected_mean=math.nan,
        expected_largest=math.nan,
        observed_mean=COVERAGE_FACTOR * result.made.grid_u,
        observed_largest=math.nan,
        coverage_factor=COVERAGE_FACTOR,
        location=list(location),
        location_value=[entry.value for entry in location.values()],
        location_u=[entry.u if entry.identifiable else math.nan for entry in location.values()],
        tracker_link=machine.tracker.link,
        alignment=transform_to_message(first_pose(result)),
        samples=fit.samples,
        used=fit.used,
        pieces=fit.pieces,
        unknowns=fit.unknowns,
        rank=fit.rank,
        coverage=min(1.0, fit.coverage),
        path_mae_before=fit.path_mae_before,
        path_mae_after=fit.path_mae_after,
        residual_rms=fit.residual_rms,
        motions=list(sizes),
        motion_largest=[largest for largest, _ in sizes.values()],
        motion_u=[u for _, u in sizes.values()],
        not_identifiable=list(result.made.hidden),
        needs=[result.advice.get(name, '') for name in result.made.hidden],
        warnings=list(result.warnings),
    )
    for name in machine.squareness:
        setattr(message, name.lower(), result.tables.squareness[name].value)
        setattr(message, f'u_{name.lower()}', result.tables.squareness[name].u)
    return message


def _xyz(values: Array) -> dict[str, float]:
    return dict(zip('xyz', values.tolist(), strict=True))

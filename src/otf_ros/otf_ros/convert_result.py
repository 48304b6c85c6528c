# SPDX-License-Identifier: Apache-2.0
"""Results of a calibration to messages."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, TransformStamped, Vector3

from otf_core.arrays import Array
from otf_core.calibration.calibration_result import (
    CalibrationResult,
    motion_sizes,
    volume_errors,
)
from otf_core.errors import ShapeError
from otf_core.model.evaluation import VolumeErrors
from otf_core.model.frames import RigidTransform
from otf_core.prediction.calibration_document import (
    FAIL,
    NOT_STATED,
    OPEN,
    PASS,
    UNKNOWN,
    CalibrationDocument,
)
from otf_core.version import __version__
from otf_msgs.msg import CalibrationResult as ResultMessage
from otf_msgs.msg import ErrorTable, TargetPlace
from otf_msgs.msg import ErrorTables as TablesMessage
from otf_msgs.msg import VolumeErrors as VolumeMessage
from otf_ros import frames
from otf_ros.convert import (
    columns_of,
    fields_of,
    header,
    time_from_ns,
    transform_to_message,
)

MACHINE_STATES = {
    NOT_STATED: ResultMessage.LIMITS_NOT_STATED,
    PASS: ResultMessage.LIMITS_KEPT,
    OPEN: ResultMessage.LIMITS_NOT_PROVEN,
    UNKNOWN: ResultMessage.LIMITS_NOT_PROVEN,
    FAIL: ResultMessage.LIMITS_BROKEN,
}
ZERO_GAUGE = 'zero at axis position 0, else at the minimum'
STRAIGHTNESS_GAUGE = 'zero at both ends; its slope lies in squareness and alignment'


def _tables_to_messages(document: CalibrationDocument) -> list[ErrorTable]:
    """Return one message per error motion, EXX to ECZ first."""
    return [
        ErrorTable(
            **fields_of(
                ErrorTable,
                table,
                motion=name,
                node_identifiable=table.nodes_seen,
                gauge=STRAIGHTNESS_GAUGE if name.is_straightness else ZERO_GAUGE,
            )
        )
        for name, table in document.motions.items()
    ]


def tables_to_message(result: CalibrationResult, stamp: Time, method: str) -> TablesMessage:
    """Return all errors of one calibration; where its files lie is left empty."""
    document, run = result.document, result.origin[0]
    machine, columns = document.machine, ('value', 'u', 'u_run', 'identifiable')
    return TablesMessage(
        header=header(stamp),
        run_id=result.run_id,
        machine=machine.name,
        chain=str(machine.chain),
        method=method,
        passed=not result.failed_gates,
        tables=_tables_to_messages(document),
        **columns_of(document.squareness, 'squareness', *columns),
        **columns_of(document.location, 'location', *columns),
        targets=[
            TargetPlace(
                name=name,
                link=own.link,
                place=Point(**_xyz(own.place)),
                u=Vector3(**_xyz(own.u)),
                u_run=Vector3(**_xyz(own.u_run)),
            )
            for name, own in document.targets.items()
        ],
        tracker_link=machine.tracker.link,
        alignment=transform_to_message(result.T_machine_tracker),
        software=f'otf_core {__version__}',
        first=time_from_ns(run.first_ns),
        last=time_from_ns(run.last_ns),
        samples=run.samples,
        run_sha256=run.sha256,
        machine_sha256=machine.file_sha256,
    )


def _xyz(values: Array) -> dict[str, float]:
    return dict(zip('xyz', values.tolist(), strict=True))


def alignment_to_message(T_machine_tracker: RigidTransform, stamp: Time) -> TransformStamped:
    """Return the place of the tracker: takes tracker coordinates to machine coordinates."""
    return TransformStamped(
        header=header(stamp),
        child_frame_id=frames.tracker(),
        transform=transform_to_message(T_machine_tracker),
    )


def result_to_message(result: CalibrationResult, stamp: Time, method: str) -> ResultMessage:
    """Return the summary; what only the node knows (lost samples, folder) is left empty."""
    fit, machine, first = result.fit, result.tables.machine, result.headline
    verdicts, location = result.verdicts, result.tables.location
    sizes = motion_sizes(result.tables)
    message = ResultMessage(
        header=header(stamp),
        run_id=result.run_id,
        status=verdicts.exit_code,
        message=result.sentence,
        measurement_good=verdicts.measurement.good,
        measurement_verdict=verdicts.measurement.sentence,
        machine_state=MACHINE_STATES[verdicts.machine.state],
        machine_verdict=verdicts.machine.sentence,
        machine=machine.name,
        chain=str(machine.chain),
        method=method,
        tracker_link=machine.tracker.link,
        alignment=transform_to_message(result.T_machine_tracker),
        **fields_of(ResultMessage, fit),
        volumetric_error_mean=first.error['mean'],
        volumetric_error_largest=first.error['max'],
        u_mean=first.u['mean'],
        u_largest=first.u['max'],
        u_run_mean=first.u_run['mean'],
        u_run_largest=first.u_run['max'],
        coverage_factor=first.k,
        systematic=first.systematic,
        motions=list(sizes),
        motion_largest=[largest for largest, _ in sizes.values()],
        motion_u=[u for _, u in sizes.values()],
        **columns_of(location, 'location', 'value'),
        location_u=[v.u if v.identifiable else math.nan for v in location.values()],
        not_identifiable=list(result.not_identifiable),
        needs=[result.advice.get(name, '') for name in result.not_identifiable],
        warnings=list(result.warnings),
    )
    for name in machine.squareness:
        setattr(message, name.lower(), result.tables.squareness[name].value)
        setattr(message, f'u_{name.lower()}', result.tables.squareness[name].u)
    return message


def volume_to_message(volume: VolumeErrors, run_id: str, stamp: Time) -> VolumeMessage:
    """Return predicted errors on a grid."""
    vectors = [
        [Vector3(x=x, y=y, z=z) for x, y, z in field.tolist()]
        for field in (volume.errors, volume.u)
    ]
    return VolumeMessage(
        header=header(stamp),
        run_id=run_id,
        provisional=volume.provisional,
        axes=list(volume.axes),
        positions=volume.positions.ravel().tolist(),
        points=[Point(x=x, y=y, z=z) for x, y, z in volume.points.tolist()],
        errors=vectors[0],
        u=vectors[1],
    )


def volume_from_message(message: VolumeMessage) -> VolumeErrors:
    """Return predicted errors on a grid; ShapeError if their numbers differ."""
    fields = [
        np.array([(v.x, v.y, v.z) for v in field], float).reshape(-1, 3)
        for field in (message.points, message.errors, message.u)
    ]
    axes, count = tuple(message.axes), len(message.points)
    if len(message.positions) != count * len(axes):
        raise ShapeError(
            f'{len(message.positions)} positions of {len(axes)} axes at {count} points'
        )
    positions = (
        np.array(message.positions, float).reshape(-1, len(axes)) if axes else np.empty((0, 0))
    )
    return VolumeErrors(*fields, message.provisional, axes, positions)


@dataclass(frozen=True)
class Messages:
    """What is published of a calibration; lost samples and folder are left empty."""

    tables: TablesMessage
    alignment: TransformStamped
    result: ResultMessage
    volume: VolumeMessage


def messages_of(
    result: CalibrationResult, stamp: Time, method: str, *, provisional: bool = False
) -> Messages:
    """Return all messages of a calibration.

    Parameters
    ----------
    provisional : bool
        Of a part of the run.
    """
    volume = volume_errors(result, provisional)
    return Messages(
        tables_to_message(result, stamp, method),
        alignment_to_message(result.T_machine_tracker, stamp),
        result_to_message(result, stamp, method),
        volume_to_message(volume, result.run_id, stamp),
    )


def failure_to_message(exit_code: int, text: str, stamp: Time) -> ResultMessage:
    """Return the summary of a calibration that gave no result."""
    return ResultMessage(header=header(stamp), status=exit_code, message=text)

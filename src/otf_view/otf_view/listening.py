# SPDX-License-Identifier: Apache-2.0
"""Ears of a viewer: what the nodes publish goes into one LiveRun."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path as FilePath

from geometry_msgs.msg import PointStamped, TransformStamped
from nav_msgs.msg import Path
from rclpy.node import Node

from otf_core.errors import OtfError
from otf_core.live.live_run import LiveRun, LiveSolution, RunProgress
from otf_core.model.motions import SQUARENESS
from otf_msgs.msg import CalibrationResult, CalibratorState, VolumeErrors
from otf_ros import convert, convert_result, qos
from otf_ros.drain import LatestMessage
from otf_ros.timers import create_timer

LOOK = 0.2
"""s; how often the newest sample is looked at."""


class LiveRunListener:
    """Keeps a LiveRun up to date.

    Samples are subscribed to once the calibrator takes some: a driver that waits for listeners
    shall wait for the calibrator, not for a picture.

    Attributes
    ----------
    news : int
        Grows whenever path, errors on the grid or result change.
    folder : Path or None
        Of the files of the last result.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.run = LiveRun()
        self.news = 0
        self.folder: FilePath | None = None
        self._points: LatestMessage | None = None
        subscribe = node.create_subscription
        for topic in ('planner/path', 'calibrator/track'):  # the latter of several parts
            subscribe(Path, topic, partial(self._on_path, topic), qos.PATH)
        subscribe(CalibratorState, 'calibrator/state', self._on_state, qos.STATUS)
        subscribe(TransformStamped, 'calibrator/alignment', self._on_alignment, qos.RESULT)
        subscribe(CalibrationResult, 'calibrator/result', self._on_result, qos.RESULT)
        subscribe(VolumeErrors, 'calibrator/volume', self._on_volume, qos.RESULT)
        create_timer(node, LOOK, self._look)

    def _look(self) -> None:
        if self._points is None and self.run.collecting:
            self._points = LatestMessage(self._node, PointStamped, 'tracker/point')
        message = self._points.newest() if self._points else None
        if message and self.run.collecting:
            self.run.track.add(message.point.x, message.point.y, message.point.z)

    def _on_path(self, topic: str, message: Path) -> None:
        try:
            self.run.set_path(convert.path_from_message(message))
        except OtfError as error:
            self._node.get_logger().warning(f'{topic} ignored: {error}')
            return
        self.news += 1

    def _on_state(self, message: CalibratorState) -> None:
        fields = {
            'state': message.name,
            'stage': message.stage,
            'fraction': message.progress,
            'time_left': message.time_left,
            'samples': message.samples,
            'lost': message.samples_lost,
            'travelled': message.travelled,
            'parts': message.parts,
            'part': message.part,
            'target': message.target,
            'message': message.message,
        }
        self.run.set_progress(RunProgress(**fields), time.monotonic())

    def _on_alignment(self, message: TransformStamped) -> None:
        self.run.set_pose(convert.transform_from_message(message.transform))
        self.news += 1

    def _on_result(self, message: CalibrationResult) -> None:
        self.folder = FilePath(message.output_directory) if message.output_directory else None
        sizes = zip(message.motion_largest, message.motion_u, strict=True)
        location = zip(message.location_value, message.location_u, strict=True)
        solved = LiveSolution(
            ok=message.status == CalibrationResult.OK,
            message=message.message,
            mae_before=message.path_mae_before,
            mae_after=message.path_mae_after,
            residual_rms=message.residual_rms,
            motions=dict(zip(message.motions, sizes, strict=True)),
            squareness={
                name: (getattr(message, name.lower()), getattr(message, f'u_{name.lower()}'))
                for name in SQUARENESS
            },
            location=dict(zip(message.location, location, strict=True)),
            warnings=tuple(message.warnings),
        )
        self.run.solved = solved
        self.news += 1

    def _on_volume(self, message: VolumeErrors) -> None:
        try:
            self.run.volume = convert_result.volume_from_message(message)
        except OtfError as error:
            self._node.get_logger().warning(f'calibrator/volume ignored: {error}')
            return
        self.news += 1

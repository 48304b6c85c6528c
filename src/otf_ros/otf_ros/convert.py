# SPDX-License-Identifier: Apache-2.0
"""Messages to data of the core and back; stamps stay int64 nanoseconds, exact both ways."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PointStamped, PoseStamped, Transform
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from otf_core.bags.cdr import frame_text
from otf_core.bags.sample_order import usable_path
from otf_core.errors import InputError
from otf_core.model.axis_path import AxisPath
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import TOOL
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.plan import Part, Plan
from otf_msgs.msg import Plan as PlanMessage
from otf_ros import frames

NS = 1_000_000_000


def time_from_ns(stamp_ns: int) -> Time:
    """Return a message time for integer nanoseconds."""
    sec, nanosec = divmod(int(stamp_ns), NS)
    return Time(sec=sec, nanosec=nanosec)


def ns_from_time(stamp: Time) -> int:
    """Return integer nanoseconds of a message time."""
    return int(stamp.sec) * NS + int(stamp.nanosec)


def now_ns(node: Node) -> int:
    """Time of the graph, ns: of the computer, or of ``/clock`` once it is there."""
    return node.get_clock().now().nanoseconds or time.time_ns()


def now(node: Node) -> Time:
    """The same for a message."""
    return time_from_ns(now_ns(node))


def header(stamp: Time, frame: str = '') -> Header:
    """Return a header; of the frame of the machine, if no other is named."""
    return Header(stamp=stamp, frame_id=frame or frames.machine())


def fields_of(kind: Any, source: object, **own: Any) -> dict[str, Any]:
    """Fields of a message that an object has under the same name; arrays as lists.

    Parameters
    ----------
    **own : object
        Fields that are not as they are there.
    """
    names = [name for name in kind.get_fields_and_field_types() if hasattr(source, name)]
    found = {name: getattr(source, name) for name in names} | own
    return {n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in found.items()}


def columns_of(entries: Mapping[str, Any], name: str, *columns: str) -> dict[str, list[Any]]:
    """Fields of a message that list entries of a document: NAME their names, NAME_column."""
    values = {f'{name}_{c}': [getattr(e, c) for e in entries.values()] for c in columns}
    return {name: list(entries), **values}


def points_to_messages(samples: Samples) -> Iterator[PointStamped]:
    """Yield one message per sample, always the same object: publish it before the next one."""
    message = PointStamped()
    message.header.frame_id = frames.tracker()
    stamp, point = message.header.stamp, message.point
    seconds, nanoseconds = np.divmod(samples.stamp_ns, NS)
    rows = zip(seconds.tolist(), nanoseconds.tolist(), samples.xyz.tolist(), strict=True)
    for sec, nanosec, (x, y, z) in rows:
        stamp.sec, stamp.nanosec = sec, nanosec
        point.x, point.y, point.z = x, y, z
        yield message


def points_from_messages(
    messages: Iterable[PointStamped],
) -> dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Return stamps (n,) in ns and points (n, 3) in m by the frames of the messages.

    That of the samples is called ``tracker`` here, whatever the graph calls it.
    """
    rows: dict[str, list[tuple[int, float, float, float]]] = {}
    for message in messages:
        head, point = message.header, message.point
        stamp_ns = head.stamp.sec * NS + head.stamp.nanosec
        rows.setdefault(head.frame_id, []).append((stamp_ns, point.x, point.y, point.z))
    return {
        _contract_name(frame): (
            np.array([row[0] for row in rows_of_frame], np.int64),
            np.array([row[1:] for row in rows_of_frame], float),
        )
        for frame, rows_of_frame in rows.items()
    }


def _contract_name(frame: str) -> str:
    if frame == frames.tracker():
        return frames.TRACKER
    return f'{frame} (not {frames.tracker()})' if frame == frames.TRACKER else frame


def path_to_message(path: NominalPath, stamp: Time) -> Path:
    """Return the corner points as a path; orientations carry no meaning and are identity."""
    message = Path(header=header(stamp))
    for x, y, z in path.points.tolist():
        pose = PoseStamped(header=message.header)
        pose.pose.position = Point(x=x, y=y, z=z)
        message.poses.append(pose)
    return message


def path_from_message(message: Path) -> NominalPath:
    """Return the path of a message; InputError if it is none, or in another frame."""
    for what, head in [('path', message.header), *(('a pose', p.header) for p in message.poses)]:
        if head.frame_id != frames.machine() and (what == 'path' or head.frame_id):
            raise InputError(frame_text(what, head.frame_id, frames.machine()))
    positions = [pose.pose.position for pose in message.poses]
    points = np.array([(p.x, p.y, p.z) for p in positions], float).reshape(-1, 3)
    return usable_path('planner/path', points)


def path_for_journal(message: Path) -> Path:
    """Return the message with the name of the frame that journals and bags have."""
    for head in (message.header, *(pose.header for pose in message.poses)):
        head.frame_id = frames.MACHINE
    return message


def axes_to_message(part: AxisPath, stamp: Time) -> JointTrajectory:
    """Return a part of a run as a trajectory without times; its frame names the target."""
    points = [JointTrajectoryPoint(positions=row) for row in part.positions.tolist()]
    head = header(stamp, part.target)
    return JointTrajectory(header=head, joint_names=list(part.axes), points=points)


def axes_from_message(message: JointTrajectory) -> AxisPath:
    """Return the part that a trajectory says; InputError if it is none."""
    names, rows = tuple(message.joint_names), [point.positions for point in message.points]
    for number, row in enumerate(rows):
        if len(row) != len(names):
            raise InputError(f'point {number} has {len(row)} positions of {len(names)} joints')
    positions = np.array(rows, float).reshape(-1, len(names))
    return AxisPath(names, positions, message.header.frame_id or TOOL)


def path_of_part(part: AxisPath, stamp: Time) -> Path:
    """Return the path of a machine with linear axes that has a part of its tool alone.

    Raises
    ------
    InputError
        If another target is in view.
    """
    if part.target != TOOL:
        raise InputError(f"target '{part.target}': without rotary axes it is '{TOOL}'")
    return path_to_message(NominalPath(part.positions), stamp)


def plan_to_message(
    plan: Plan, machine: str, length: float, duration: float, stamp: Time
) -> PlanMessage:
    """Return a plan message for the machine of this name.

    Parameters
    ----------
    length, duration : float
        Of the track of the reflectors, m, and of all parts, s.
    """
    digest = hashlib.sha256()
    for part in plan.parts:
        digest.update(part.target.encode())
        for array in (part.path.positions, part.feed, part.dwell):
            digest.update(np.ascontiguousarray(array).tobytes())
    return PlanMessage(
        header=header(stamp),
        plan_id=digest.hexdigest()[:16],
        machine=machine,
        parts=[axes_to_message(part.path, stamp) for part in plan.parts],
        feed=np.concatenate([part.feed for part in plan.parts]).tolist(),
        dwell=np.concatenate([part.dwell for part in plan.parts]).tolist(),
        length=length,
        duration=duration,
    )


def plan_from_message(message: PlanMessage) -> Plan:
    """Return the plan of a message; InputError or ShapeError if it is none."""
    paths = [axes_from_message(part) for part in message.parts]
    if not paths:
        raise InputError('a plan without parts')
    ends = np.cumsum([len(path.positions) for path in paths])
    feeds = np.split(np.array(message.feed, float), ends[:-1] - np.arange(1, len(paths)))
    dwells = np.split(np.array(message.dwell, float), ends[:-1])
    return Plan(tuple(Part(*own) for own in zip(paths, feeds, dwells, strict=True)))


def transform_to_message(transform: RigidTransform) -> Transform:
    """Return a rigid transform as translation and unit quaternion."""
    from scipy.spatial.transform import Rotation  # loaded on use: a driver needs none

    message = Transform()
    x, y, z, w = Rotation.from_matrix(transform.rotation).as_quat().tolist()
    message.rotation.x, message.rotation.y, message.rotation.z, message.rotation.w = x, y, z, w
    t = message.translation
    t.x, t.y, t.z = transform.translation.tolist()
    return message


def transform_from_message(message: Transform) -> RigidTransform:
    """Return the rigid transform of a translation and a unit quaternion."""
    from scipy.spatial.transform import Rotation

    r, t = message.rotation, message.translation
    rotation = Rotation.from_quat([r.x, r.y, r.z, r.w]).as_matrix()
    return RigidTransform(rotation, np.array([t.x, t.y, t.z]))

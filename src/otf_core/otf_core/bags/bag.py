# SPDX-License-Identifier: Apache-2.0
"""Bags: tracker points and nominal path from and to rosbag2 recordings, without ROS.

A bag is a rosbag2 folder or an .mcap file with the topics ``/tracker/point``
(geometry_msgs/msg/PointStamped in frame ``tracker``, header.stamp is the time of measurement) and
``/planner/path`` (nav_msgs/msg/Path in frame ``machine``). Any other topics are skipped. Poses and
transforms do for points; topics of other names are taken where they are named, in any frame.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from otf_core.bags.bag_reading import BagReading, Reading, path_of
from otf_core.bags.bag_writer import write_recording
from otf_core.bags.publishers import advice_of, received_of
from otf_core.bags.sample_order import in_time_order, usable_path
from otf_core.bags.screening import MixedSamples, Screening
from otf_core.bags.topics import PATH, POINT, Topic
from otf_core.errors import InputError
from otf_core.files.text_table import LeftOut
from otf_core.model.axis_path import AxisPath
from otf_core.model.declared_signals import SignalSpec
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.signals import Signal

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BagContent:
    """What a bag says.

    Attributes
    ----------
    samples : Samples
        Stamps strictly increase.
    path : NominalPath, optional
        None where axis paths stand for it.
    remarks : tuple of str
        What was repaired or left out, in words.
    left_out : tuple of LeftOut
        Lines of a text that are no samples, by reason.
    signals : mapping of SignalSpec to Signal
        To be written beside them; reading is ``signals.read_signals``.
    axis_paths : tuple of AxisPath
        Parts of a run of a machine with rotary axes.
    """

    samples: Samples
    path: NominalPath | None
    remarks: tuple[str, ...] = ()
    signals: Mapping[SignalSpec, Signal] = field(default_factory=dict)
    left_out: tuple[LeftOut, ...] = ()
    axis_paths: tuple[AxisPath, ...] = ()


def read_bag(
    source: str | Path, *, recover: bool = False, point: Topic = POINT, path: Topic = PATH
) -> BagContent:
    """Read points and path.

    Points are taken in the order of reception (log time) and then put in the order of their own
    stamps, see ``sample_order.in_time_order``. A path that was published several times must be
    the same each time.

    Parameters
    ----------
    source : str or Path
        A rosbag2 folder (any number of parts, any storage or compression that rosbags reads), a
        folder with a single .mcap file or numbered parts, or an .mcap file. An MCAP file that is
        cut off or still being recorded is read to its last complete chunk.
    recover : bool
        Leave out damaged chunks inside an MCAP file as well, instead of refusing the bag.
    point, path : Topic
        See ``topics.called`` for other names.

    Raises
    ------
    ConfigError
        If the source does not exist or is by its kind no bag.
    InputError
        If the bag is damaged or does not hold usable points and one usable path; the message says
        what, where and what to do.
    """
    return read_parts([source], recover=recover, point=point, path=path)


def read_parts(
    sources: Sequence[str | Path],
    *,
    recover: bool = False,
    point: Topic = POINT,
    path: Topic = PATH,
) -> BagContent:
    """Read bags that are parts of one run, in any order, as if they were one bag.

    Every part has points; the path stands in one of them at least, the same in all that have it.
    """
    return content_of([BagReading(s, point, path, recover=recover) for s in sources], sources)


def read_points(source: str | Path, *, recover: bool = False, point: Topic = POINT) -> Samples:
    """Read the points of a bag that may lack a path; otherwise as ``read_bag``."""
    return points_of(BagReading(source, point, None, recover=recover), source)


def content_of(
    parts: Sequence[Reading], sources: Sequence[str | Path], path: str | Path | None = None
) -> BagContent:
    """Join what was read of the parts of a run; the log says what was left out or taken for what.

    Parameters
    ----------
    parts : sequence of Reading
        Of each of the sources. A single one has to have a path if it may have one.
    sources : sequence of str or Path
    path : str or Path, optional
        File that the path comes from, for messages.
    """
    for part in parts:
        part.require(part.point)
        if part.path is not None and len(parts) == 1 and not part.axis_paths:
            part.require(part.path)
    where = str(sources[0]) if len(sources) == 1 else f'{sources[0]} and {len(sources) - 1} more'
    samples, remarks = _told(where, parts)
    left_out = tuple(lines for part in parts for lines in part.left_out)
    axis_paths = tuple(own for part in parts for own in part.axis_paths)
    driven = None
    if not axis_paths or any(part.paths for part in parts):
        driven = path_of(str(path or where), parts)
    return BagContent(samples, driven, tuple(remarks), left_out=left_out, axis_paths=axis_paths)


def points_of(part: Reading, source: str | Path) -> Samples:
    """Return the samples of one recording, whether it has a path or not; see ``content_of``."""
    part.require(part.point)
    return _told(str(source), [part])[0]


def _told(where: str, parts: Sequence[Reading]) -> tuple[Samples, list[str]]:
    """Samples of parts, and remarks; both kinds of words go to the log."""
    remarks = [text for part in parts for text in part.remarks]
    samples = samples_of(where, parts, remarks)
    for text in (said for part in parts for said in part.said):
        _log.info('%s: %s', where, text)
    for text in remarks:
        _log.warning('%s: %s', where, text)
    return samples, remarks


def samples_of(where: str, parts: Sequence[Reading], remarks: list[str]) -> Samples:
    """Join the points of parts; ``remarks`` is filled with what was repaired or left out."""
    received = [received_of(part, where, remarks) for part in parts]
    raw = sorted(received, key=lambda r: r.stamp_ns[:1].tolist())
    stamp_ns, xyz = (
        raw[0].stamp_ns if len(raw) == 1 else np.concatenate([r.stamp_ns for r in raw]),
        raw[0].xyz if len(raw) == 1 else np.concatenate([r.xyz for r in raw]),
    )
    screening = Screening()
    screening.foreign(sum((part.foreign for part in parts), Counter()))
    try:
        return in_time_order(f'{where}: {parts[0].point.name}', stamp_ns, xyz, remarks, screening)
    except MixedSamples as error:
        raise MixedSamples(f'{error}{advice_of(received)}') from None


def write_bag(folder: str | Path, content: BagContent, *, overwrite: bool = False) -> None:
    """Write a rosbag2 folder (metadata.yaml and one MCAP file with zstd chunks).

    The path comes first, then every point and signal with its stamp as log time. The same content
    gives the same bytes. The folder appears under its name only when it is complete.

    Parameters
    ----------
    folder : str or Path
        The new bag; missing parent folders are made.
    content : BagContent
    overwrite : bool
        Replace the folder if it is a bag or empty; never anything else.

    Raises
    ------
    ConfigError
        If the folder exists or cannot be written.
    InputError
        If the content is not what ``read_bag`` would give back unchanged.
    """
    samples = content.samples
    remarks: list[str] = []
    in_time_order(f'{folder}: samples', samples.stamp_ns, samples.xyz, remarks)
    if not np.all(samples.stamp_ns[1:] > samples.stamp_ns[:-1]):
        raise InputError(f'{folder}: stamps of samples to write have to increase strictly')
    if remarks:
        raise InputError(f'{folder}: samples would not be read as they are: {remarks[0]}')
    if content.path is not None:
        usable_path(f'{folder}: path', content.path.points)
    elif not content.axis_paths:
        raise InputError(f'{folder}: a bag needs a path')
    write_recording(
        Path(folder), samples, content.path, overwrite, content.signals, content.axis_paths
    )

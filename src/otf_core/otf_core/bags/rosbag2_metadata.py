# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag; metadata.yaml of a rosbag2 folder, version 9, and the MCAP file beside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import IO, TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from mcap.writer import Writer

# The topics of a bag: name, message type, frame and quality of service.


@dataclass(frozen=True)
class Topic:
    """A topic as other tools know it.

    Attributes
    ----------
    name, type, frame : str
        An empty frame stands for any.
    depth : int
        Messages a publisher keeps for a reliable reader.
    durability : str
        ``transient_local`` where a late reader gets the last message.
    """

    name: str
    type: str
    frame: str
    depth: int
    durability: str


POINT = Topic('/tracker/point', 'geometry_msgs/msg/PointStamped', 'tracker', 1000, 'volatile')
PATH = Topic('/planner/path', 'nav_msgs/msg/Path', 'machine', 1, 'transient_local')
AXES = Topic('/planner/axes', 'trajectory_msgs/msg/JointTrajectory', '', 1, 'transient_local')
"""In place of a path, of machines with rotary axes: a message for every part of a run; its frame
names the target."""
STATUS = Topic('/tracker/status', 'otf_msgs/msg/TrackerStatus', 'tracker', 1, 'transient_local')
"""Only in journals; nothing depends on it offline."""
GAP = Topic('/tracker/gap', 'otf_msgs/msg/TrackerGap', 'tracker', 1000, 'transient_local')
"""The same: breaks of the stream as the driver states them."""


def rename_topic(topic: Topic, name: str | None) -> Topic:
    """Return a topic under another name, whose frame is then as it comes; None: as it is."""
    if name is None:
        return topic
    return replace(topic, name='/' + name.removeprefix('/'), frame='')


# metadata.yaml of a rosbag2 folder, version 9, and what channels say of their publishers.

CREATOR = 'otf_core'
FOREVER = {'sec': 9223372036, 'nsec': 854775807}


@dataclass(frozen=True)
class Part:
    """One storage file of a bag: first and last log time in ns, messages of every topic."""

    name: str
    start: int
    end: int
    counts: Mapping[Topic, int]

    def span(self) -> dict[str, Any]:
        """Return duration, start and number of messages."""
        return {
            'duration': {'nanoseconds': self.end - self.start},
            'starting_time': {'nanoseconds_since_epoch': self.start},
            'message_count': sum(self.counts.values()),
        }


def _qos(topic: Topic) -> dict[str, Any]:
    return {
        'history': 'keep_last',
        'depth': topic.depth,
        'reliability': 'reliable',
        'durability': topic.durability,
        'deadline': dict(FOREVER),
        'lifespan': dict(FOREVER),
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(FOREVER),
        'avoid_ros_namespace_conventions': False,
    }


def channel_metadata(topic: Topic) -> dict[str, str]:
    """Return what the channel of a topic says of its publisher, so that play latches it."""
    return {'offered_qos_profiles': yaml.safe_dump([_qos(topic)], sort_keys=False)}


def bag_metadata(
    parts: Sequence[Part], hashes: Mapping[Topic, str], custom: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return what metadata.yaml says under ``rosbag2_bagfile_information``.

    Parameters
    ----------
    parts : sequence of Part
        In the order of recording; one at least.
    hashes : mapping of Topic to str
        Type description hashes of all topics, in the order in which they are listed.
    custom : mapping of str to str, optional
        Anything else.
    """
    counts: Counter[Topic] = Counter()
    for part in parts:
        counts.update(part.counts)
    start, end = min(p.start for p in parts), max(p.end for p in parts)
    return {
        'version': 9,
        'storage_identifier': 'mcap',
        **Part('', start, end, counts).span(),
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic.name,
                    'type': topic.type,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': [_qos(topic)],
                    'type_description_hash': hashed,
                },
                'message_count': counts[topic],
            }
            for topic, hashed in hashes.items()
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [part.name for part in parts],
        'files': [{'path': part.name, **part.span()} for part in parts],
        'custom_data': dict(custom) if custom else None,
        'ros_distro': CREATOR,
    }


def metadata_text(metadata: Mapping[str, Any]) -> str:
    """Return the text of metadata.yaml."""
    return yaml.safe_dump({'rosbag2_bagfile_information': metadata}, sort_keys=False)


def describe_topics(
    topics: Iterable[Topic], texts: Mapping[str, str] = MappingProxyType({})
) -> tuple[dict[Topic, str], dict[Topic, str]]:
    """Message definition and type description hash of topics, but of types that are not known.

    Parameters
    ----------
    texts : mapping of str to str
        Message definitions of types that are not part of ROS 2 itself.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # 0.1 s

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in texts.items():
        store.register(get_types_from_msg(text, name))
    known = [t for t in topics if t.type in store.fielddefs]
    definitions = {t: store.generate_msgdef(t.type, ros_version=2)[0] for t in known}
    return definitions, {t: store.hash_rihs01(t.type) for t in known}


def start_mcap(
    stream: IO[bytes], definitions: Mapping[Topic, str], *, data_crcs: bool = False
) -> tuple[Writer, dict[Topic, int]]:
    """Begin an MCAP file of compressed chunks; return its writer and the channels of topics."""
    from mcap.writer import CompressionType, Writer

    writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=data_crcs)
    writer.start(profile='ros2', library=CREATOR)
    channels = {}
    for topic, text in definitions.items():
        schema = writer.register_schema(topic.type, 'ros2msg', text.encode())
        about = channel_metadata(topic)
        channels[topic] = writer.register_channel(topic.name, 'cdr', schema, about)
    return writer, channels

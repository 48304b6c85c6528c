# SPDX-License-Identifier: Apache-2.0
"""One run of a journal: a rosbag2 folder that grows, and is taken up again after a crash.

Its state stands in metadata.yaml (``custom_data``): ``recording`` as long as samples may be added,
then what became of the run. A run that is taken up goes on in a further part.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from otf_core.bags.bag_source import locate
from otf_core.bags.cdr import DecodedPoints, decode_points
from otf_core.bags.journal_file import JournalFile, Rows, repair
from otf_core.bags.mcap_messages import MessageBlock
from otf_core.bags.rosbag2_metadata import Part, bag_metadata, metadata_text
from otf_core.bags.topics import GAP, OTHER_POINT, PATH, POINT, STATUS, Topic
from otf_core.errors import ConfigError, InputError
from otf_core.files.strict_yaml import read_yaml

TOPICS = (PATH, STATUS, POINT)
"""Of which a run consists, and what it is taken up from."""
ASIDE = (GAP, OTHER_POINT)
"""Kept beside it."""
RECORDING = 'recording'
"""State of a run to which samples may be added."""
STATE = 'otf_state'
METADATA = 'metadata.yaml'
UPDATE = 1.0
"""s; metadata.yaml is written anew at most so often while the run is recorded."""


@dataclass(frozen=True)
class Definitions:
    """Message definitions of the topics of a journal; ``texts`` of types that rosbags lacks.

    ``beside`` are further topics than ``TOPICS``.
    """

    texts: Mapping[str, str]
    beside: tuple[Topic, ...] = ()

    @property
    def all(self) -> tuple[Topic, ...]:
        """Topics of a journal."""
        return (*TOPICS, *ASIDE, *self.beside)

    @cached_property
    def both(self) -> tuple[dict[Topic, str], dict[Topic, str]]:
        """Definition and hash of every topic."""
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store = get_typestore(Stores.ROS2_JAZZY)
        for name, text in self.texts.items():
            store.register(get_types_from_msg(text, name))
        topics = [t for t in self.all if t.type in store.fielddefs]
        texts = {t: store.generate_msgdef(t.type, ros_version=2)[0] for t in topics}
        return texts, {t: store.hash_rihs01(t.type) for t in topics}


class JournalRun:
    """A run that is written; every failure is an OSError.

    Parameters
    ----------
    folder : Path
        Made with the first rows.
    definitions : Definitions
    parts : sequence of Part
        Parts that are there already.
    """

    def __init__(self, folder: Path, definitions: Definitions, parts: Sequence[Part] = ()) -> None:
        self.folder = folder
        self._definitions, self._parts = definitions, list(parts)
        self._file: JournalFile | None = None
        self._updated = 0.0

    def append(self, rows: Sequence[Rows]) -> None:
        """Write a chunk; it is on the disk when this returns."""
        if self._file is None:
            self.folder.mkdir(parents=True, exist_ok=True)
            path = self.folder / f'{self.folder.name}_{len(self._parts)}.mcap'
            self._file = JournalFile(path, self._definitions.both[0])
        self._file.append(rows)
        if time.monotonic() - self._updated > UPDATE or not (self.folder / METADATA).exists():
            self._update(RECORDING)

    def close(self, state: str = RECORDING) -> None:
        """End the present part, if there is one, and say what became of the run."""
        if self._file is not None:
            self._file.finish()
            self._file.release()
            self._parts.append(self._file.part)
            self._file = None
        if self._parts:
            self._update(state)

    def _update(self, state: str) -> None:
        present = [self._file.part] if self._file else []
        hashes = self._definitions.both[1]
        data = bag_metadata([*self._parts, *present], hashes, {STATE: state})
        _replace_text(self.folder / METADATA, metadata_text(data))
        self._updated = time.monotonic()


def _replace_text(path: Path, text: str) -> None:
    partial = path.with_name(f'.{path.name}.new')
    with partial.open('w', encoding='utf-8') as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(partial, path)


def state_of(folder: Path) -> str:
    """Return the state of a run; empty if the folder is no run of a journal."""
    try:
        data = read_yaml(folder / METADATA)
        return str(data['rosbag2_bagfile_information']['custom_data'][STATE])
    except (ConfigError, TypeError, KeyError):
        return ''


def set_state(folder: Path, state: str) -> None:
    """Say what became of a run that is not written any more; OSError if that fails."""
    path = folder / METADATA
    try:
        data = read_yaml(path)
        data['rosbag2_bagfile_information']['custom_data'] = {STATE: state}
    except (ConfigError, TypeError, KeyError) as error:
        raise OSError(f'{path}: {error}') from None
    _replace_text(path, metadata_text(data['rosbag2_bagfile_information']))


def unfinished(directory: Path) -> list[Path]:
    """Runs that are still to be calibrated, the newest last."""
    found = [p for p in sorted(directory.iterdir()) if any(p.glob('*_0.mcap'))]
    return [p for p in found if state_of(p) == RECORDING or not (p / METADATA).exists()]


@dataclass(frozen=True)
class Recorded:
    """What a run holds, and the run to go on with.

    Attributes
    ----------
    run : JournalRun
    end_ns : int
        When the last message was received.
    arrived : tuple
        Points, and messages of ``TOPICS`` as they were received, in their order.
    """

    run: JournalRun
    end_ns: int
    arrived: tuple[tuple[Topic, DecodedPoints | bytes], ...]


def take_up(folder: Path, definitions: Definitions) -> Recorded:
    """Read an unfinished run, so that it goes on.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    files = sorted(folder.glob('*.mcap'), key=lambda p: int(p.stem.rpartition('_')[2]))
    try:
        repair(files[-1])
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f'{folder}: cannot be taken up ({error})') from None
    parts: list[Part] = []
    blocks: list[MessageBlock] = []
    for file in files:
        found = list(locate(file).messages({t.name: (t.type,) for t in definitions.all}, {}))
        blocks += found
        if found:
            times = np.concatenate([b.log_time for b in found])
            counts: Counter[Topic] = Counter()
            for block in found:
                counts[_topic(block, definitions.all)] += block.start.size
            parts.append(Part(file.name, int(times.min()), int(times.max()), counts))
        else:
            parts.append(Part(file.name, 0, 0, {}))
    end = max((part.end for part in parts), default=0)
    own = {t.name for t in TOPICS}
    arrived = tuple(_in_order([b for b in blocks if b.topic in own]))
    return Recorded(JournalRun(folder, definitions, parts), end, arrived)


def _topic(block: MessageBlock, topics: Sequence[Topic] = TOPICS) -> Topic:
    return next(t for t in topics if t.name == block.topic)


def _in_order(blocks: Sequence[MessageBlock]) -> Iterator[tuple[Topic, DecodedPoints | bytes]]:
    """Yield points and other messages in the order in which they were received."""
    others = sorted(
        (int(t), k, i)
        for k, block in enumerate(blocks)
        if block.topic != POINT.name
        for i, t in enumerate(block.log_time)
    )
    points = [b for b in blocks if b.topic == POINT.name]
    for block in points:
        while others and others[0][0] <= block.log_time[0]:
            yield _message(blocks, others.pop(0))
        cuts = [int(np.searchsorted(block.log_time, t)) for t, _, _ in others]
        at = 0
        for cut in (c for c in cuts if c < block.start.size):
            yield from _points(block, at, cut)
            yield _message(blocks, others.pop(0))
            at = cut
        yield from _points(block, at, block.start.size)
    for other in others:
        yield _message(blocks, other)


def _message(blocks: Sequence[MessageBlock], at: tuple[int, int, int]) -> tuple[Topic, bytes]:
    block = blocks[at[1]]
    start, size = int(block.start[at[2]]), int(block.size[at[2]])
    return _topic(block), bytes(block.buffer[start : start + size])


def _points(block: MessageBlock, start: int, stop: int) -> Iterator[tuple[Topic, DecodedPoints]]:
    if stop > start:
        rows = slice(start, stop)
        yield POINT, decode_points(block.buffer, block.start[rows], block.size[rows], POINT.frame)

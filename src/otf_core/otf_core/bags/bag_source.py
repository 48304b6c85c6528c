# SPDX-License-Identifier: Apache-2.0
"""Where the messages of a bag lie: an .mcap file or a rosbag2 folder, and how to read them."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from otf_core.bags.mcap_messages import McapMessages, MessageBlock, Wanted, check_type
from otf_core.errors import ConfigError, InputError
from otf_core.files.strict_yaml import read_yaml

EXPECTED = 'a bag is a rosbag2 folder or an .mcap file'
BATCH = 20_000
"""Messages that the general reader joins to one block."""
MOST_UNPACKED, MAX_RATIO = 1 << 28, 200
"""Bytes; a compressed file that unpacks to more, and to so many times its size, is refused."""


@dataclass(frozen=True)
class BagSource:
    """A bag that exists.

    Attributes
    ----------
    path : Path
        As given by the user: a folder or a file.
    files : tuple of Path
        Its storage files in recording order.
    plain : bool
        All files are MCAP without file or message compression (chunks may be compressed).
    """

    path: Path
    files: tuple[Path, ...]
    plain: bool

    def messages(
        self,
        wanted: Wanted,
        topics: dict[str, str],
        remarks: list[str] | None = None,
        *,
        recover: bool = False,
    ) -> Iterator[MessageBlock]:
        """Yield the messages of the wanted topics and collect all topics with their types.

        Parameters
        ----------
        wanted : mapping of topic to message types
        topics : dict of topic to message type
            Filled while reading.
        remarks : list of str
            Filled with what is missing of files without their end.
        recover : bool
            Leave out what is damaged inside MCAP files instead of refusing them.

        Raises
        ------
        InputError
            If the bag is damaged or a wanted topic has another type.
        """
        if self.plain:
            for file in self.files:
                yield from McapMessages(file, wanted, topics, remarks, recover=recover)
        else:
            yield from _general_messages(self.path, wanted, topics)


def locate(source: str | Path) -> BagSource:
    """Find the storage files of a bag.

    Raises
    ------
    ConfigError
        If the path does not exist or is by its kind no bag.
    InputError
        If a folder is no bag, holds several, or files of it are missing.
    """
    path = Path(source)
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise ConfigError(f'{path}: {reason}; {EXPECTED}') from None
    if stat.S_ISDIR(mode):
        try:
            return _locate_in_folder(path)
        except OSError as error:
            raise InputError(f'{path}: cannot be read ({error.strerror})') from None
    if path.name == 'metadata.yaml':
        raise ConfigError(f'{path}: name the folder it lies in; {EXPECTED}')
    if path.suffix == '.bag':
        raise ConfigError(f"{path}: is a ROS 1 bag; convert it with 'rosbags-convert' first")
    if path.suffix not in ('.mcap', '.db3') or not stat.S_ISREG(mode):
        swapped = '; is that machine.yaml?' if path.suffix in ('.yaml', '.yml') else ''
        raise ConfigError(f'{path}: is no bag; {EXPECTED}{swapped}')
    return BagSource(path, (path,), path.suffix == '.mcap')


def _locate_in_folder(folder: Path) -> BagSource:
    if (folder / 'metadata.yaml').is_file():
        return _from_metadata(folder)
    found = sorted(p for p in folder.iterdir() if p.suffix in ('.mcap', '.db3') and p.is_file())
    if len(found) == 1:
        return BagSource(found[0], (found[0],), found[0].suffix == '.mcap')
    if found and _are_parts(found):  # rosbag2 writes metadata.yaml when it ends
        parts = tuple(sorted(found, key=_part))
        return BagSource(folder, parts, True)
    if found:
        raise InputError(
            f'{folder}: holds {len(found)} recordings ({_names(found)}) and no metadata.yaml; '
            f"name one of them, or run 'ros2 bag reindex' if they are parts of one"
        )
    inside = sorted(p for p in folder.iterdir() if p.is_dir() and (p / 'metadata.yaml').is_file())
    if inside:
        raise InputError(f'{folder}: is no bag but holds some ({_names(inside)}); name one')
    raise InputError(f'{folder}: holds neither metadata.yaml nor an .mcap file; {EXPECTED}')


def _part(path: Path) -> int:
    """Number of a part of a recording by its name, NAME_0.mcap; -1 if it is none."""
    number = path.stem.rpartition('_')[2]
    return int(number) if number.isascii() and number.isdecimal() and len(number) < 7 else -1


def _are_parts(found: list[Path]) -> bool:
    """Tell whether files are the parts that rosbag2 splits a recording into, none missing."""
    same = {p.stem.rpartition('_')[0] for p in found}
    numbers = sorted(map(_part, found))
    plain = all(p.suffix == '.mcap' for p in found)
    return plain and len(same) == 1 and numbers == list(range(len(found)))


def _names(paths: list[Path]) -> str:
    shown = ', '.join(p.name for p in paths[:5])
    return shown + (', ...' if len(paths) > 5 else '')


def _from_metadata(folder: Path) -> BagSource:
    file = folder / 'metadata.yaml'
    try:
        data: Any = read_yaml(file)
    except (ConfigError, ValueError, RecursionError) as error:
        # ValueError: YAML dates that do not exist; RecursionError: nested without end
        text = str(error).removeprefix(f'{file}: ')
        raise InputError(f"{file}: {text}; 'ros2 bag reindex' writes it anew") from None
    info = data.get('rosbag2_bagfile_information') if isinstance(data, dict) else None
    names = info.get('relative_file_paths') if isinstance(info, dict) else None
    if not isinstance(info, dict) or not isinstance(names, list) or not names:
        raise InputError(
            f'{file}: lists no files under rosbag2_bagfile_information/relative_file_paths; '
            f"'ros2 bag reindex' writes it anew"
        )
    files = tuple(folder / PurePath(str(name)).name for name in names)
    missing = [p for p in files if not p.is_file()]
    if missing:
        raise InputError(
            f'{folder}: {len(missing)} of {len(files)} files listed in metadata.yaml are missing '
            f'({_names(missing)}); copy the whole folder'
        )
    packed = str(info.get('compression_mode') or 'none').lower() != 'none'
    plain = not packed and all(p.suffix == '.mcap' for p in files)
    return BagSource(folder, files, plain)


def _general_messages(
    path: Path, wanted: Wanted, topics: dict[str, str]
) -> Iterator[MessageBlock]:
    """Yield what rosbags reads: sqlite3 storage, compressed files or messages."""
    from rosbags.rosbag2 import Reader  # costs 50 ms that plain MCAP does not need

    for file in sorted(path.glob('*.zstd')) if path.is_dir() else ():
        _check_unpacked(file)
    try:
        with Reader(path) as reader:
            topics.update({c.topic: c.msgtype for c in reader.connections})
            for connection in reader.connections:
                encoding = getattr(connection.ext, 'serialization_format', 'cdr')
                check_type(path, connection.topic, connection.msgtype, encoding, wanted)
            for topic in wanted.keys() & topics.keys():
                chosen = [c for c in reader.connections if c.topic == topic]
                messages = ((time, data) for _, time, data in reader.messages(chosen))
                stated = sum(c.msgcount for c in chosen)
                yield from _blocks(path, topic, messages, stated)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001
        # rosbags passes on what apsw, zstd, lz4, ruamel and struct raise on damaged files
        detail = ' '.join(f'{type(error).__name__}: {error}'.split())[:300]
        raise InputError(f'{path}: cannot be read as a bag ({detail})') from None


def _check_unpacked(file: Path) -> None:
    """Refuse a compressed file that unpacks to far more than recordings do."""
    import zstandard

    most = max(MOST_UNPACKED, MAX_RATIO * file.stat().st_size)
    size = 0
    try:
        with file.open('rb') as stream:
            for block in zstandard.ZstdDecompressor().read_to_iter(stream):
                size += len(block)
                if size > most:
                    raise InputError(
                        f'{file}: unpacks to more than {most >> 20} MB, {MAX_RATIO} times its '
                        f'size, and no recording does; it is not read'
                    )
    except (zstandard.ZstdError, OSError):
        return  # the reader says what is wrong


def _blocks(
    path: Path, topic: str, messages: Iterator[tuple[int, bytes]], stated: int
) -> Iterator[MessageBlock]:
    """Join messages to blocks; InputError if there are not as many as the bag states."""
    count = 0
    while batch := list(islice(messages, BATCH)):
        size = np.array([len(data) for _, data in batch], np.int64)
        buffer = np.frombuffer(b''.join(data for _, data in batch), np.uint8)
        log_time = np.array([time for time, _ in batch], np.int64)
        yield MessageBlock(topic, buffer, np.cumsum(size) - size, size, log_time)
        count += len(batch)
    if count != stated:
        raise InputError(
            f'{path}: is damaged, {topic} has {count} messages but the bag states {stated}'
        )

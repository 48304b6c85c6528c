# SPDX-License-Identifier: Apache-2.0
"""Where the messages of a bag lie: an .mcap file or a rosbag2 folder, and how to read them."""

from __future__ import annotations

import gzip
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, cast

from otf_core.bags.mcap_messages import (
    McapMessages,
    MessageBlock,
    Wanted,
    check_type,
    join_messages,
)
from otf_core.errors import ConfigError, InputError
from otf_core.files.strict_yaml import read_yaml

EXPECTED = 'a bag is a rosbag2 folder or an .mcap file'
STORAGES = ('.mcap', '.db3')
PACKINGS = ('.zstd', '.zst', '.lz4', '.gz')
"""Suffixes of storage files, and of what may have compressed them as a whole."""
ROS1 = "convert it first, as in 'rosbags-convert --src RUN.bag --dst RUN'"
UNPACKED_AT_ONCE = 1 << 20
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
    packed : bool
        Its messages are compressed one by one, as metadata.yaml states.
    """

    path: Path
    files: tuple[Path, ...]
    packed: bool = False

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
        remarks = [] if remarks is None else remarks
        if self.packed:
            yield from _general_messages(self.path, wanted, topics)
            return
        for file in self.files:
            yield from _file_messages(file, wanted, topics, remarks, recover=recover)


def locate(source: str | Path) -> BagSource:
    """Find the storage files of a bag.

    Raises
    ------
    ConfigError
        If the path does not exist or is by its kind no bag.
    InputError
        If a folder is not a bag, holds several, or files of it are missing.
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
        raise ConfigError(f'{path}: name its folder; {EXPECTED}')
    if path.suffix == '.bag':
        raise ConfigError(f'{path}: is a ROS 1 bag; {ROS1}')
    if not is_storage(path) or not stat.S_ISREG(mode):
        swapped = '; is that machine.yaml?' if path.suffix in ('.yaml', '.yml') else ''
        raise ConfigError(f'{path}: is not a bag; {EXPECTED}{swapped}')
    return BagSource(path, (path,))


def is_storage(path: Path) -> bool:
    """Return whether a file holds messages, compressed as a whole or not, by its name."""
    return _storage(path) in STORAGES


def _storage(path: Path) -> str:
    """Suffix of a storage file without that of its compression."""
    return Path(path.stem).suffix if path.suffix in PACKINGS else path.suffix


def _locate_in_folder(folder: Path) -> BagSource:
    if (folder / 'metadata.yaml').is_file():
        return _from_metadata(folder)
    storages = sorted(p for p in folder.iterdir() if is_storage(p) and p.is_file())
    if len(storages) == 1:
        return BagSource(storages[0], (storages[0],))
    if storages and _are_parts(storages):  # rosbag2 writes metadata.yaml when it ends
        return BagSource(folder, tuple(sorted(storages, key=_part)))
    if storages:
        raise InputError(
            f'{folder}: holds {len(storages)} recordings ({_names(storages)}) and no '
            f'metadata.yaml; '
            f"name one of them, or run 'ros2 bag reindex' if they are parts of one"
        )
    inside = sorted(p for p in folder.iterdir() if p.is_dir() and (p / 'metadata.yaml').is_file())
    if inside:
        raise InputError(f'{folder}: is not a bag but holds some ({_names(inside)}); name one')
    raise InputError(f'{folder}: holds neither metadata.yaml nor an .mcap file; {EXPECTED}')


def _part(path: Path) -> int:
    """Number of a part of a recording by its name, NAME_0.mcap; -1 if it is none."""
    number = _bare(path).rpartition('_')[2]
    return int(number) if number.isascii() and number.isdecimal() and len(number) < 7 else -1


def _are_parts(files: list[Path]) -> bool:
    """Return whether files are the parts that rosbag2 splits a recording into, none missing."""
    same = {(_bare(p).rpartition('_')[0], _storage(p)) for p in files}
    numbers = sorted(map(_part, files))
    return len(same) == 1 and numbers == list(range(len(files)))


def _bare(path: Path) -> str:
    """Name of a storage file without its suffixes."""
    return path.name.removesuffix(path.suffix if path.suffix in PACKINGS else '').rpartition('.')[
        0
    ]


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
        raise InputError(f"{file}: {text}; 'ros2 bag reindex' rewrites it") from None
    info = data.get('rosbag2_bagfile_information') if isinstance(data, dict) else None
    names = info.get('relative_file_paths') if isinstance(info, dict) else None
    if not isinstance(info, dict) or not isinstance(names, list) or not names:
        raise InputError(
            f'{file}: lists no files under rosbag2_bagfile_information/relative_file_paths; '
            f"'ros2 bag reindex' rewrites it"
        )
    files = tuple(folder / PurePath(str(name)).name for name in names)
    missing = [p for p in files if not p.is_file()]
    if missing:
        raise InputError(
            f'{folder}: {len(missing)} of {len(files)} files listed in metadata.yaml are missing '
            f'({_names(missing)}); copy the whole folder'
        )
    strange = [p for p in files if not is_storage(p)]
    if strange:
        raise InputError(f'{file}: lists {_names(strange)}; supported are .mcap and .db3')
    packed = str(info.get('compression_mode')).lower() == 'message'
    return BagSource(folder, files, packed)


def _file_messages(
    file: Path, wanted: Wanted, topics: dict[str, str], remarks: list[str], *, recover: bool
) -> Iterator[MessageBlock]:
    """Yield the messages of one storage file."""
    if file.suffix in PACKINGS:
        yield from _unpacked_messages(file, wanted, topics, remarks, recover=recover)
    elif file.suffix == '.mcap':
        yield from McapMessages(file, wanted, topics, remarks, recover=recover)
    else:
        log = file.with_name(f'{file.name}-wal')
        if log.is_file() and log.stat().st_size:
            raise InputError(
                f'{file}: the contents of {log.name} were not merged when the recorder ended; '
                f'merge '
                f"them with: sqlite3 {file} 'PRAGMA wal_checkpoint(TRUNCATE)'"
            )
        yield from _general_messages(file, wanted, topics)


def _unpacked_messages(
    file: Path, wanted: Wanted, topics: dict[str, str], remarks: list[str], *, recover: bool
) -> Iterator[MessageBlock]:
    """Yield the messages of a storage file that is compressed as a whole.

    InputError if it is damaged or far larger than recordings are.
    """
    most, size = max(MOST_UNPACKED, MAX_RATIO * file.stat().st_size), 0
    with TemporaryDirectory(prefix='otf-') as folder:
        plain = Path(folder) / file.stem
        try:
            with file.open('rb') as raw, _stream_of(file, raw) as stream, plain.open('wb') as out:
                while size <= most and (block := stream.read(UNPACKED_AT_ONCE)):
                    size += out.write(block)
        except Exception as error:  # noqa: BLE001
            # zstandard, lz4, gzip and zlib have errors of their own
            raise InputError(f'{file}: cannot be unpacked ({error}); copy it again') from None
        if size > most:
            raise InputError(
                f'{file}: unpacks to more than {most >> 20} MB, {MAX_RATIO} times its size, which '
                f'is implausible for a recording; it is not read'
            )
        try:
            yield from _file_messages(plain, wanted, topics, remarks, recover=recover)
        except InputError as error:
            raise InputError(str(error).replace(str(plain), str(file))) from None


def _stream_of(file: Path, raw: BinaryIO) -> BinaryIO:
    """Open what a compressed file holds."""
    if file.suffix == '.gz':
        return cast(BinaryIO, gzip.GzipFile(fileobj=raw))
    if file.suffix == '.lz4':
        from lz4 import frame

        return cast(BinaryIO, frame.LZ4FrameFile(raw))
    import zstandard

    return cast(BinaryIO, zstandard.ZstdDecompressor().stream_reader(raw, read_across_frames=True))


def _general_messages(
    path: Path, wanted: Wanted, topics: dict[str, str]
) -> Iterator[MessageBlock]:
    """Yield what rosbags reads: sqlite3 storage, compressed files or messages."""
    from rosbags.rosbag2 import Reader  # costs 50 ms that plain MCAP does not need

    try:
        with Reader(path) as reader:
            topics.update({c.topic: c.msgtype for c in reader.connections})
            for connection in reader.connections:
                encoding = getattr(connection.ext, 'serialization_format', 'cdr')
                check_type(path, connection.topic, connection.msgtype, encoding, wanted)
            for topic in wanted.keys() & {c.topic for c in reader.connections}:
                chosen = [c for c in reader.connections if c.topic == topic]
                messages = ((time, data) for _, time, data in reader.messages(chosen))
                stated, count = sum(c.msgcount for c in chosen), 0
                for block in join_messages(topic, messages):
                    yield block
                    count += block.start.size
                if count != stated:
                    raise InputError(
                        f'{path}: is damaged, {topic} has {count} messages but the bag states '
                        f'{stated}'
                    )
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001
        # rosbags passes on what apsw, zstd, lz4, ruamel and struct raise on damaged files
        detail = ' '.join(f'{type(error).__name__}: {error}'.split())[:300]
        raise InputError(f'{path}: cannot be read as a bag ({detail})') from None

# SPDX-License-Identifier: Apache-2.0
"""The block ``provenance`` of every JSON file: when, from what, by what, in which convention.

Only its ``written`` depends on more than data, options and version; the environment variable
SOURCE_DATE_EPOCH (s since 1970) replaces it where results have to repeat to the last byte.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError
from otf_core.files.output_folder import file_digest
from otf_core.files.text_table import SkippedLines
from otf_core.files.writing import unreadable
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.version import __version__

CONVENTION = (
    'error = actual minus nominal, of the target relative to the table, in machine coordinates; '
    'm, rad and s unless a name says otherwise'
)
STANDARD = 'u: standard uncertainty, k = 1'
RUN_HASH = (
    'SHA-256 of stamps (int64, ns), points (float64, m) and corner points of the path (float64, '
    'm), little-endian, in the order of time'
)
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_OLDEST_NS = 946_684_800_000_000_000
"""ns; stamps before 2000 count from some other epoch and tell no date."""


@dataclass(frozen=True)
class Origin:
    """A recording that results come from.

    Attributes
    ----------
    first_ns, last_ns : int
        Stamps of the first and the last sample, on the tracker's clock.
    sha256 : str
        See ``RUN_HASH``: the same for copies of a bag in another storage.
    machine : Machine, optional
        As it was described for this run.
    left_out : tuple of SkippedLines
        Lines of a text that are not samples, by reason.
    """

    name: str
    samples: int
    first_ns: int
    last_ns: int
    sha256: str
    machine: Machine | None = None
    left_out: tuple[SkippedLines, ...] = ()


def _raw(values: NDArray[Any], kind: str) -> memoryview:
    """Bytes of an array in a stated type, without a copy where it has that already."""
    return np.ascontiguousarray(values, kind).reshape(-1).view(np.uint8).data


def origin_of(
    name: str, samples: Samples, path: NominalPath | None = None, machine: Machine | None = None
) -> Origin:
    """State what a recording is."""
    digest = hashlib.sha256(_raw(samples.stamp_ns, '<i8'))
    digest.update(_raw(samples.xyz, '<f8'))
    if path is not None:
        digest.update(_raw(path.points, '<f8'))
    first, last = int(samples.stamp_ns[0]), int(samples.stamp_ns[-1])
    return Origin(name, len(samples), first, last, digest.hexdigest(), machine)


class RecordingOrigin(Protocol):
    """What a recording has to tell of itself, such as ``runs.Recording``."""

    @property
    def name(self) -> str:
        """Where it comes from."""

    @property
    def samples(self) -> Samples:
        """All samples."""

    @property
    def path(self) -> NominalPath:
        """The nominal path."""

    @property
    def machine(self) -> Machine:
        """The machine as set up in this run."""

    @property
    def left_out(self) -> tuple[SkippedLines, ...]:
        """Lines that are not samples."""


def origins(recordings: Iterable[RecordingOrigin]) -> tuple[Origin, ...]:
    """State what recordings are; they go by the last part of their names."""
    return tuple(
        replace(
            origin_of(Path(r.name).name or r.name, r.samples, r.path, r.machine),
            left_out=r.left_out,
        )
        for r in recordings
    )


def moment(stamp_ns: int) -> str | None:
    """UTC by ISO 8601 to the microsecond; None if the stamp tells no date."""
    if stamp_ns < _OLDEST_NS:
        return None
    try:
        time = _EPOCH + timedelta(microseconds=stamp_ns // 1000)
    except OverflowError:
        return None
    return time.isoformat(timespec='microseconds').replace('+00:00', 'Z')


def _written() -> str:
    given = os.environ.get('SOURCE_DATE_EPOCH', '')
    try:
        now = _EPOCH + timedelta(seconds=int(given)) if given else datetime.now(timezone.utc)
    except (ValueError, OverflowError):
        raise ConfigError(f'SOURCE_DATE_EPOCH: {given!r} is not a number of seconds') from None
    return now.isoformat(timespec='seconds').replace('+00:00', 'Z')


def _measured(runs: Sequence[Origin]) -> dict[str, str | None] | None:
    if not runs:
        return None
    first, last = min(r.first_ns for r in runs), max(r.last_ns for r in runs)
    return {'first': moment(first), 'last': moment(last)}


def _run(origin: Origin) -> dict[str, Any]:
    return {
        'name': origin.name,
        'samples': origin.samples,
        'first_stamp_ns': origin.first_ns,
        'last_stamp_ns': origin.last_ns,
        'measured': {'first': moment(origin.first_ns), 'last': moment(origin.last_ns)},
        'sha256': origin.sha256,
    } | ({'left_out': list(map(asdict, origin.left_out))} if origin.left_out else {})


def _machine(machine: Machine) -> dict[str, str | None]:
    return {'name': machine.name, 'sha256': machine.file_sha256 or None}


def provenance(
    verb: str,
    *,
    method: str | None = None,
    runs: Sequence[Origin] = (),
    machines: Sequence[Machine] = (),
    files: Mapping[str, str | Path | None] | None = None,
    coverage: str = STANDARD,
) -> dict[str, Any]:
    """Return the block as plain data.

    Parameters
    ----------
    verb : str
        Command that the file comes from.
    method : str, optional
        'otf' or 'standstill'.
    machines : sequence of Machine
        Descriptions that were read besides those of the runs; repeated ones count once.
    files : mapping of str to path, optional
        Other files that were read, by what they are; None: not given.
    coverage : str
        What u and U stand for.

    Raises
    ------
    ConfigError
        If one of the files cannot be read.
    """
    block: dict[str, Any] = {
        'written': _written(),
        'software': {'name': 'otf_core', 'version': __version__},
        'verb': verb,
        'method': method,
        'convention': CONVENTION,
        'coverage': coverage,
    }
    if runs:
        block |= {'measured': _measured(runs), 'runs': [_run(r) for r in runs]}
        block['sha256_of_runs'] = RUN_HASH
    described: list[dict[str, str | None]] = []
    for machine in (*(r.machine for r in runs), *machines):
        if machine is not None and _machine(machine) not in described:
            described.append(_machine(machine))
    if described:
        block |= {'machines': described, 'sha256_of_machines': 'SHA-256 of the file machine.yaml'}
    given = {what: name for what, name in (files or {}).items() if name is not None}
    if given:
        block['files'] = {what: _file(name) for what, name in given.items()}
    return block


def _file(name: str | Path) -> dict[str, str]:
    try:
        return {'name': str(name), 'sha256': file_digest(name)}
    except OSError as error:
        raise unreadable(name, error) from None

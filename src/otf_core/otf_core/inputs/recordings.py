# SPDX-License-Identifier: Apache-2.0
"""Recordings of any form, with a path from them or beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from otf_core.bags.bag import BagContent, content_of
from otf_core.bags.bag_reading import BagReading
from otf_core.bags.bag_signals import read_signals
from otf_core.bags.cdr import FORMS
from otf_core.bags.rosbag2_metadata import AXES, PATH, POINT, rename_topic
from otf_core.errors import ConfigError, InputError
from otf_core.inputs.path_file import holds_axis_positions, read_axis_paths, read_path
from otf_core.inputs.text_points import TextReading, is_text
from otf_core.model.axis_path import AxisPath, nominal_track
from otf_core.model.machine import BED, TOOL, Machine, load_machine
from otf_core.model.motions import AXES as LINEAR
from otf_core.model.path import MIN_LEG, NominalPath
from otf_core.pieces.runs import Recording, errors_of

AnyReading = BagReading | TextReading


@dataclass(frozen=True)
class ReadingOptions:
    """How a recording is to be read, where it does not say so itself.

    Attributes
    ----------
    path : str or Path, optional
        A plan.json, a CSV of corner points or of axis positions, or an NC program; takes the
        place of a path in the recording.
    topic, path_topic : str, optional
        Other names of the two topics of a bag.
    columns : str, optional
        What stands in the columns of a text, e.g. ``time_s,x_mm,y_mm,z_mm``.
    rate : float, optional
        Hz; of samples in a text without times.
    time_format : str, optional
        Form of the times in a text, in words of ``strptime``, e.g. ``%d.%m.%Y %H:%M:%S.%f``.
    recover : bool
        Leave out damaged chunks of a bag.
    """

    path: str | Path | None = None
    topic: str | None = None
    path_topic: str | None = None
    columns: str | None = None
    rate: float | None = None
    recover: bool = False
    time_format: str | None = None

    def __post_init__(self) -> None:
        """Refuse a rate that is none."""
        if self.rate is not None and not 0.0 < self.rate <= 1e5:
            raise ConfigError(f'--rate: {self.rate:g} is out of range (0, 100000] Hz')


AS_IT_IS = ReadingOptions()


def open_reading(source: str | Path, given: ReadingOptions = AS_IT_IS) -> AnyReading:
    """Read what a recording holds.

    Raises
    ------
    ConfigError
        If there is no recording, or what is given does not suit it.
    InputError
        If it is damaged; says what, where, and what to do.
    """
    if is_text(source):
        if given.topic or given.path_topic:
            raise ConfigError(f'topic: {source} is a text table and has no topics')
        reading: AnyReading = TextReading(source, given.columns, given.rate, given.time_format)
    else:
        for option, value in (
            ('--columns', given.columns),
            ('--rate', given.rate),
            ('--time-format', given.time_format),
        ):
            if value is not None and Path(source).exists():
                raise ConfigError(f'{option}: {source} is a bag; this option is for text tables')
        reading = _read_bag(source, given)
    if given.path is not None and holds_axis_positions(given.path):
        reading.paths, reading.axis_paths = [], read_axis_paths(given.path)
    elif given.path is not None:
        corners, words = read_path(given.path)
        reading.paths = [corners]
        if words:
            reading.said.append(words)
    return reading


def _read_bag(source: str | Path, given: ReadingOptions) -> BagReading:
    """Read a bag; a topic of another name is taken where it is the only one of its kind."""
    names = {POINT: given.topic, PATH: given.path_topic}

    def read() -> BagReading:
        point, path = (rename_topic(topic, name) for topic, name in names.items())
        wanted = path if given.path is None else None
        return BagReading(source, point, wanted, recover=given.recover)

    reading = read()
    kinds = {POINT: tuple(FORMS), PATH: (PATH.type,)}
    if given.path is not None or AXES.name in reading.topics:
        del kinds[PATH]
    found = {
        topic: reading.only_topic(types)
        for topic, types in kinds.items()
        if names[topic] is None and topic.name not in reading.topics
    }
    words = [f'{name} is taken for {topic.name}' for topic, name in found.items() if name]
    if words:
        names |= found
        reading = read()
        reading.said[:0] = words
    return reading


def read_content(sources: Sequence[str | Path], given: ReadingOptions = AS_IT_IS) -> BagContent:
    """Read samples and path of a run; the log says what was left out or taken for what.

    Parameters
    ----------
    sources : sequence of str or Path
        One recording, or several that are parts of the run, in any order: every part has samples,
        one of them at least the path, which is the same in all that have it.
    """
    readings = [open_reading(source, given) for source in sources]
    for other in readings[1:] if given.path is not None else ():
        other.axis_paths = []  # one file of parts belongs to all recordings together
    return content_of(readings, sources, given.path)


def read_recording(
    sources: Sequence[str | Path], machine: Machine | str | Path, given: ReadingOptions = AS_IT_IS
) -> Recording:
    """Read a recorded run of a machine, see ``read_content``.

    Raises
    ------
    ConfigError
        If there is no recording, or machine.yaml is wrong.
    InputError
        If it cannot be used.
    """
    content = read_content(sources, given)
    used = machine if isinstance(machine, Machine) else load_machine(machine)
    declared = () if len(sources) > 1 or is_text(sources[0]) else used.signals
    signals = read_signals(sources[0], declared)
    name = str(sources[0])
    with errors_of(name):
        path = path_of_machine(content.axis_paths, content.path, used)
    return Recording(
        content.samples,
        path,
        used,
        name,
        content.remarks,
        signals,
        left_out=content.left_out,
    )


def _check_missing_axes(path: NominalPath, machine: Machine) -> None:
    """Refuse a path that moves along what the machine has no axis for."""
    for name, travel in zip(machine.point_names, np.ptp(path.points, axis=0), strict=True):
        if name not in machine.axis_names and travel > MIN_LEG:
            raise InputError(
                f'the path moves {1e3 * travel:.4g} mm along {name}, which the chain '
                f'{machine.chain} of {machine.name} does not; is machine.yaml that of the '
                f'recorded machine?'
            )


def path_of_machine(
    axis_paths: Sequence[AxisPath], path: NominalPath | None, machine: Machine
) -> NominalPath:
    """Track of the parts that were published; the path of the tool where they are one of it.

    Raises
    ------
    InputError
        If what was published is not that of such a machine.
    """
    parts = tuple(part.of(machine) for part in axis_paths)
    if not parts and path is not None and not machine.rotary_names:
        _check_missing_axes(path, machine)
        parts = (AxisPath(machine.axis_names, machine.axis_positions(path.points)),)
    if not parts:
        letters = ','.join(machine.axis_names).lower()
        other = (
            '; the path found is that of a machine with three linear axes: is machine.yaml that '
            'of the recorded machine?'
            if path is not None
            else ''
        )
        raise InputError(
            f'axis positions are missing: {machine.name} has the chain {machine.chain}; record '
            f'{AXES.name} ({AXES.type}), or give --path plan.json or a CSV target,{letters}{other}'
        )
    from_bed = machine.tracker.link == BED and machine.chain.table_side
    if machine.axis_names != LINEAR or from_bed or [p.target for p in parts] != [TOOL]:
        return nominal_track(machine, parts)
    return path if path is not None else NominalPath(parts[0].positions)

# SPDX-License-Identifier: Apache-2.0
"""A recording as far as it can be read, aligned and reduced: what its checks look at."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace

from otf_core.arrays import Array
from otf_core.bags.bag_reading import Received, path_of
from otf_core.bags.publishers import advice_of, received_of
from otf_core.bags.sample_order import in_time_order
from otf_core.bags.screening import MixedSamples, Screening
from otf_core.config import CalibrationConfig
from otf_core.contradictions.examine import examine
from otf_core.contradictions.recording_checks import check_recordings
from otf_core.contradictions.stamps import check_samples
from otf_core.errors import InputError
from otf_core.inputs.recordings import Given, open_reading
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.pieces.finding import Finding
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.threads import one_thread
from otf_core.tracking.alignment import Alignment, align
from otf_core.tracking.no_match import check_partial


@dataclass(frozen=True)
class Seen:
    """A recording as far as it could be followed.

    Attributes
    ----------
    name : str
    topics : mapping of topic to message type
    config : CalibrationConfig
    received : Received, optional
    samples : Samples, optional
        In the order of time, unusable ones dropped.
    path : NominalPath, optional
    machine : Machine, optional
    alignment : Alignment, optional
    run : Run, optional
        Reduced to pieces; needs a machine.
    findings : tuple of Finding
        Contradictions in it.
    nodes : mapping of axis to ndarray, m, optional
        Of the tables.
    remarks : tuple of str
        What was mended while it was read.
    said : tuple of str
        How it was read, where that is not as usual.
    refused : mapping of step to str
        Why a step failed: 'bag', 'points', 'path', 'stamps', 'following', 'run'.
    """

    name: str
    topics: Mapping[str, str]
    config: CalibrationConfig
    received: Received | None = None
    samples: Samples | None = None
    path: NominalPath | None = None
    machine: Machine | None = None
    alignment: Alignment | None = None
    run: Run | None = None
    findings: tuple[Finding, ...] = ()
    nodes: Mapping[str, Array] | None = None
    remarks: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    refused: Mapping[str, str] | None = None

    def why(self, step: str) -> str:
        """Why a step failed; empty if it did not, or was not reached."""
        return (self.refused or {}).get(step, '')


class _Refusals(dict[str, str]):
    """Why steps failed, by their names."""

    @contextmanager
    def of(self, step: str, name: str) -> Iterator[None]:
        try:
            yield
        except InputError as error:
            self[step] = str(error).removeprefix(f'{name}: ')


def look(source: str, machine: Machine | None, config: CalibrationConfig, given: Given) -> Seen:
    """See what can be seen of a recording.

    Parameters
    ----------
    source : str
    machine : Machine, optional
        Without it the path is followed, but nothing is said of axes and uncertainties.
    config : CalibrationConfig
    given : Given
        How it is read.

    Returns
    -------
    Seen

    Raises
    ------
    ConfigError
        If there is no such file or folder.
    """
    refused = _Refusals()
    with one_thread():
        seen = _read(source, config, given, refused)
        if seen.samples is not None:
            seen = _followed(replace(seen, machine=machine), refused)
    return replace(seen, machine=machine, refused=refused)


def _read(source: str, config: CalibrationConfig, given: Given, refused: _Refusals) -> Seen:
    seen = Seen(source, {}, config)
    remarks: list[str] = []
    with refused.of('bag', source):
        reading = open_reading(source, given)
        remarks += reading.remarks
        seen = replace(seen, topics=reading.topics, said=tuple(reading.said))
        with refused.of('path', source):
            if reading.path is not None:
                reading.require(reading.path)
            seen = replace(seen, path=path_of(source, [reading]))
        with refused.of('points', source):
            reading.require(reading.point)
            received = received_of(reading, source, remarks)
            seen = replace(seen, received=received)
            screening = Screening()
            screening.foreign(reading.foreign)
            raw = received.stamp_ns, received.xyz
            try:
                where = f'{source}: {reading.point.name}'
                samples = in_time_order(where, *raw, remarks, screening)
            except MixedSamples as error:
                raise MixedSamples(f'{error}{advice_of([received])}') from None
            seen = replace(seen, samples=samples)
    return replace(seen, remarks=tuple(remarks))


def _followed(seen: Seen, refused: _Refusals) -> Seen:
    """Align and reduce what was read."""
    name, samples, path, machine = seen.name, seen.samples, seen.path, seen.machine
    config = seen.config
    assert samples is not None
    if path is None:
        with refused.of('stamps', name):
            check_samples(samples, None)
        return seen
    if machine is not None:
        recordings = [Recording(samples, path, machine, name)]
        with refused.of('run', name):
            check_recordings(recordings)
            runs, nodes = prepare_runs(recordings, config)
            (run, *_), findings = examine(runs, nodes, config)
            return replace(seen, run=run, findings=findings, nodes=nodes, alignment=run.alignment)
    with refused.of('following', name):
        check_samples(samples, path)
        found = align(samples, path, config)
        seen = replace(seen, alignment=found)
        pose = found.T_machine_tracker
        check_partial(samples, path, pose, found.coverage, config.match_tolerance)
    return seen

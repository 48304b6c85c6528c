# SPDX-License-Identifier: Apache-2.0
"""Checks of a recording: can it be calibrated, and how well will the errors be known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.bags.bag_reading import ReceivedPoints, path_of
from otf_core.bags.rosbag2_metadata import AXES
from otf_core.bags.sample_order import Screening, sort_by_time
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import CalibrationConfig
from otf_core.contradictions.examine import examine
from otf_core.contradictions.recording_checks import check_recordings, check_samples
from otf_core.documents import Document, ResultDocument, optional, stated
from otf_core.errors import InputError
from otf_core.files.text_table import SkippedLines
from otf_core.inputs.recordings import AS_IT_IS, ReadingOptions, open_reading, path_of_machine
from otf_core.live.stages import silent
from otf_core.model.axis_path import AxisPath, PartsTrack
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.path import Legs, NominalPath
from otf_core.model.provenance import moment
from otf_core.noise.standstill import (
    MIN_TOTAL,
    find_standstills,
    lost_samples,
    moves_by_hand,
    standstill_noise,
)
from otf_core.pieces.finding import COMPLETE_PATH, GATE, MIN_COVERAGE, WARNING, Finding, words_of
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.planning.forecast import (
    Setup,
    forecast_of_runs,
    planned_systematic,
)
from otf_core.threads import one_thread
from otf_core.tracking.alignment import Alignment, align
from otf_core.tracking.driving_order import OFF_PATH
from otf_core.tracking.measured_track import HOP, find_breaks
from otf_core.tracking.no_match import check_partial

# A recording as far as it can be read, aligned and reduced: what its checks look at.


@dataclass(frozen=True)
class CheckedRecording:
    """A recording as far as it could be followed.

    Attributes
    ----------
    topics : mapping of topic to message type
    samples : Samples, optional
        In the order of time, unusable ones dropped.
    run : Run, optional
        Reduced to pieces; needs a machine of linear axes.
    parts : tuple of AxisPath
        Published axis positions of a machine with rotary axes.
    result : CalibrationResult, optional
        Of a machine with rotary axes: what shows whether a recording can be used is its
        calibration, which takes seconds.
    findings : tuple of Finding
        Contradictions in it.
    nodes : mapping of axis to ndarray, m, optional
        Of the tables.
    remarks : tuple of str
        What was repaired while it was read.
    left_out : tuple of SkippedLines
        Lines of a text table that are not samples.
    said : tuple of str
        How it was read, where that is not as usual.
    refused : mapping of step to str
        Why a step failed: 'bag', 'points', 'path', 'stamps', 'following', 'run'.
    """

    name: str
    topics: Mapping[str, str]
    config: CalibrationConfig
    received: ReceivedPoints | None = None
    samples: Samples | None = None
    path: NominalPath | None = None
    machine: Machine | None = None
    alignment: Alignment | None = None
    run: Run | None = None
    parts: tuple[AxisPath, ...] = ()
    result: CalibrationResult | None = None
    findings: tuple[Finding, ...] = ()
    nodes: Mapping[str, Array] | None = None
    remarks: tuple[str, ...] = ()
    left_out: tuple[SkippedLines, ...] = ()
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


def look(
    source: str, machine: Machine | None, config: CalibrationConfig, given: ReadingOptions
) -> CheckedRecording:
    """See what can be seen of a recording.

    Parameters
    ----------
    machine : Machine, optional
        Without it the path is followed, but axes and uncertainties are not stated.
    given : ReadingOptions
        How it is read.

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


def _read(
    source: str, config: CalibrationConfig, given: ReadingOptions, refused: _Refusals
) -> CheckedRecording:
    seen = CheckedRecording(source, {}, config)
    remarks: list[str] = []
    with refused.of('bag', source):
        reading = open_reading(source, given)
        remarks += reading.remarks
        seen = replace(seen, topics=reading.topics, said=tuple(reading.said))
        with refused.of('path', source):
            if not reading.axis_paths and AXES.name not in reading.topics:
                if reading.path is not None:
                    reading.require(reading.path)
                seen = replace(seen, path=path_of(source, [reading]))
        with refused.of('points', source):
            reading.require(reading.point)
            received = reading.received()
            seen = replace(seen, received=received, left_out=tuple(reading.left_out))
            seen = replace(seen, parts=tuple(reading.axis_paths))
            screening = Screening()
            screening.foreign(reading.foreign)
            raw = received.stamp_ns, received.xyz
            samples = sort_by_time(f'{source}: {reading.point.name}', *raw, remarks, screening)
            seen = replace(seen, samples=samples)
    return replace(seen, remarks=tuple(remarks))


def _followed(seen: CheckedRecording, refused: _Refusals) -> CheckedRecording:
    """Align and reduce what was read."""
    name, samples, path, machine = seen.name, seen.samples, seen.path, seen.machine
    config = seen.config
    assert samples is not None
    if machine is not None and machine.rotary_names:
        return _calibrated(seen, machine, refused)
    if machine is not None and (seen.parts or path is not None):
        with refused.of('path', name):
            path = path_of_machine(seen.parts, path, machine)
            if isinstance(path, PartsTrack):
                return _calibrated(seen, machine, refused)
    if path is None:
        with refused.of('stamps', name):
            check_samples(samples, None)
        return seen
    if machine is not None:
        recordings = [Recording(samples, path, machine, name)]
        with refused.of('following', name):
            check_recordings(recordings)
        if 'following' in refused:
            return seen
        with refused.of('run', name):
            runs, nodes = prepare_runs(recordings, config)
            (run, *_), findings = examine(runs, nodes, config)
            return replace(seen, run=run, findings=findings, nodes=nodes, alignment=run.alignment)
    with refused.of('following', name):
        check_samples(samples, path)
        alignment = align(samples, path, config)
        seen = replace(seen, alignment=alignment)
        pose = alignment.T_machine_tracker
        check_partial(samples, path, pose, alignment.coverage, config.match_tolerance)
    return seen


def _calibrated(seen: CheckedRecording, machine: Machine, refused: _Refusals) -> CheckedRecording:
    """Calibrate what was driven in parts."""
    assert seen.samples is not None
    with refused.of('run', seen.name):
        path = path_of_machine(seen.parts, seen.path, machine)
        recording = Recording(seen.samples, path, machine, seen.name)
        return replace(seen, result=calibrate_recordings([recording], seen.config, silent))
    return seen


ERROR = 'error'
"""A calibration would refuse the recording, or a quality gate of it would fail."""


@dataclass(frozen=True)
class Problem(Document):
    """Something wrong with a recording."""

    severity: str = stated('warning, or error: a calibration would refuse it or not be good')
    what: str = stated('what, where, and what to do')
    check: str = stated('what was looked at', default='')


@dataclass(frozen=True)
class CheckOutcome:
    """What one check found.

    Attributes
    ----------
    words : str
        For the table; empty if there is nothing to look at.
    facts : mapping of str to plain data
        In the units that the names state.
    """

    words: str = ''
    facts: Mapping[str, Any] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class Check:
    """One question to a recording.

    Attributes
    ----------
    name : str
        What is looked at, one word.
    ask : callable
        Seen to Checked.
    """

    name: str
    ask: Callable[[CheckedRecording], CheckOutcome]


def warnings(*texts: str) -> tuple[Problem, ...]:
    """Problems that a calibration can live with; empty texts are none."""
    return tuple(Problem(WARNING, text) for text in texts if text)


def errors(*texts: str) -> tuple[Problem, ...]:
    """Problems that it cannot live with; empty texts are none."""
    return tuple(Problem(ERROR, text) for text in texts if text)


def _check_content(seen: CheckedRecording) -> CheckOutcome:
    parts = list(seen.said)
    if seen.received is not None and not parts:
        parts.append(f'{len(seen.received.stamp_ns)} points')
    if seen.parts:
        targets = ', '.join(p.target for p in seen.parts)
        parts.append(f'axis positions of {len(seen.parts)} parts ({targets})')
    if seen.path is not None:
        parts.append(f'path of {len(seen.path.points)} corner points, {seen.path.length:.2f} m')
    facts = {
        'topics': dict(seen.topics),
        'samples': 0 if seen.received is None else len(seen.received.stamp_ns),
        'left_out': list(map(asdict, seen.left_out)),
    }
    problems = errors(*(seen.why(step) for step in ('bag', 'points', 'path')))
    return CheckOutcome('; '.join(parts), facts, problems + warnings(*seen.remarks))


CONTENT = Check('content', _check_content)


SAMPLES_PER_PIECE = 2.0
"""Samples of a path piece at the top feed that are wanted at least."""
TOP_FEED_PERCENTILE = 99.0
"""Percentile of the steps that is taken for the top feed."""


def _check_rate(seen: CheckedRecording) -> CheckOutcome:
    samples = seen.samples
    if samples is None or len(samples) < 2:
        return CheckOutcome(facts={'rate_hz': 0.0, 'duration_s': 0.0})
    rate = 1.0 / samples.step
    apart = np.linalg.norm(np.diff(samples.xyz, axis=0), axis=1)
    usual = np.diff(samples.stamp_ns) < 1.5 * samples.step_ns
    spacing = float(np.percentile(apart[usual], TOP_FEED_PERCENTILE)) if usual.any() else 0.0
    coarse, enough = '', seen.config.piece_length / SAMPLES_PER_PIECE
    if spacing > enough:
        coarse = (
            f'samples lie {1e3 * spacing:.1f} mm apart at the top feed, above '
            f'{1e3 * enough:g} mm: raise the rate of the tracker or drive slower'
        )
    duration = float(samples.time[-1])
    return CheckOutcome(
        f'{rate:.1f} Hz over {duration:.1f} s, a sample every {1e3 * spacing:.2f} mm at the top '
        f'feed',
        {'rate_hz': rate, 'duration_s': duration, 'spacing_mm': 1e3 * spacing},
        warnings(coarse),
    )


RATE = Check('rate', _check_rate)


LOST_SHARE = 0.01
"""Share of the samples that may be missing without a word."""
GAPS_LISTED = 3


def _breaks(samples: Samples, parts: int) -> Index:
    """Samples before the gaps of a recording, those left out in which a reflector was moved."""
    return np.setdiff1d(np.flatnonzero(find_breaks(samples)), moves_by_hand(samples, parts))


def _check_gaps(seen: CheckedRecording) -> CheckOutcome:
    samples = seen.samples
    if samples is None or len(samples) < 3:
        return CheckOutcome(facts={'gaps': 0, 'lost_share': 0.0, 'longest_gap_s': 0.0})
    missing, time = lost_samples(samples, len(seen.parts)).samples, samples.time
    at = _breaks(samples, len(seen.parts))
    length = time[at + 1] - time[at]
    share = missing / (missing + len(samples))
    longest = float(length.max()) if len(at) else 0.0
    facts = {'gaps': len(at), 'lost_share': share, 'longest_gap_s': longest}
    if not len(at):
        few = f', {missing} single samples lost' if missing else ''
        return CheckOutcome(f'none{few}', facts)
    words = f'{len(at)}, {100 * share:.1f} % of the samples lost, the longest {longest:.2f} s'
    first = np.argsort(-length)[:GAPS_LISTED]
    where = ', '.join(f'{length[k]:.2f} s at {time[at[k]]:.1f} s' for k in np.sort(first))
    more = ', ...' if len(at) > GAPS_LISTED else ''
    if share < LOST_SHARE:
        return CheckOutcome(words, facts)
    return CheckOutcome(words, facts, warnings(
        f'{100 * share:.1f} % of the samples are missing, in {len(at)} gaps ({where}{more}): '
        f'look for a broken beam, lost packets, or a recorder that was too slow'
    ))  # fmt: skip


GAPS = Check('gaps', _check_gaps)


CLOCK_STEP = 0.3
"""s; a lasting change between both clocks that no transport explains."""
CLOCK_WINDOW = 50
"""Samples on either side over which the difference of the clocks is taken."""
JITTER = 0.5
"""Usual deviation of an interval from the median, over it, from which on stamps are doubtful."""


def _check_clock(seen: CheckedRecording) -> CheckOutcome:
    samples = seen.samples
    if seen.received is None or samples is None or len(samples) < 2 * CLOCK_WINDOW:
        return CheckOutcome(problems=errors(seen.why('stamps')))
    first = moment(int(samples.stamp_ns[0]))
    words = f'starts {first}' if first else 'stamps count from an epoch of their own'
    steps = _clock_steps(seen.received)
    doubt = ''
    if len(steps):
        doubt = (
            f'the clock of the stamps was set {len(steps)} times relative to that of the '
            f'recorder, first'
            f' {steps[0]:.1f} s after the start: let the driver stamp with a clock that is '
            f'never adjusted'
        )
    step = np.diff(samples.stamp_ns)
    jitter = float(np.median(np.abs(step - np.median(step))) / np.median(step))
    uneven = ''
    if jitter > JITTER:
        uneven = (
            f'intervals of the stamps scatter by {100 * jitter:.0f} %, as reception times do: '
            f'let the driver stamp the time of measurement'
        )
    return CheckOutcome(
        f'{words}, intervals scatter by {100 * jitter:.1f} %',
        {'first_stamp': first, 'clock_set': len(steps), 'jitter': jitter},
        errors(seen.why('stamps')) + warnings(doubt, uneven),
    )


def _clock_steps(received: ReceivedPoints) -> NDArray[np.float64]:
    """Moments at which the difference of both clocks jumps and stays, s since the start."""
    late = 1e-9 * (received.log_time - received.stamp_ns)
    late -= late[0]
    jump = np.flatnonzero(np.abs(np.diff(late)) > CLOCK_STEP)
    jump = jump[(jump >= CLOCK_WINDOW) & (jump < len(late) - CLOCK_WINDOW)]

    def lasts(k: int) -> bool:
        before, after = late[k - CLOCK_WINDOW : k + 1], late[k + 1 : k + CLOCK_WINDOW]
        return bool(abs(np.median(after) - np.median(before)) > CLOCK_STEP)

    stays = [k for k in jump.tolist() if lasts(k)]
    return np.asarray(1e-9 * (received.log_time[stays] - received.log_time[0]))


CLOCK = Check('clock', _check_clock)


def _check_beam(seen: CheckedRecording) -> CheckOutcome:
    if seen.received is None or seen.samples is None:
        return CheckOutcome()
    lost = int(np.count_nonzero(~seen.received.xyz.any(axis=1)))
    samples = seen.samples
    at = _breaks(samples, len(seen.parts))
    moved = np.linalg.norm(samples.xyz[at + 1] - samples.xyz[at], axis=1) > HOP
    breaks = int(np.count_nonzero(moved))
    reach = np.linalg.norm(samples.xyz, axis=1)
    words = f'{breaks} breaks while the target moved' if breaks else 'never broken in motion'
    origin = f', {lost} points in the origin of the tracker' if lost else ''
    return CheckOutcome(
        f'{words}{origin}; {reach.min():.2f} to {reach.max():.2f} m long',
        {
            'beam_breaks': breaks,
            'without_beam': lost,
            'beam_m': [float(reach.min()), float(reach.max())],
        },
    )


BEAM = Check('beam', _check_beam)


SHORT_LEG = 4.0
"""Corner exclusions; a leg no longer is not looked for."""
LEG_SEEN = 0.5
"""Share of a leg between its corners that has to be seen."""
LEGS_LISTED = 3


def _check_path(seen: CheckedRecording) -> CheckOutcome:
    if seen.result is not None:
        return _check_parts(seen.result)
    alignment = seen.alignment
    coverage = 0.0 if alignment is None else alignment.coverage
    facts = {'coverage': coverage, 'legs_missing': 0}
    reasons = dict.fromkeys(seen.why(step) for step in ('following', 'run'))  # often the same
    problems = errors(*reasons)
    if alignment is None or seen.samples is None or seen.path is None:
        return CheckOutcome('', facts, problems)
    missing = _missing(seen.samples, seen.path, alignment, seen.config.corner_exclusion)
    facts['legs_missing'] = len(missing)
    if coverage < COMPLETE_PATH:
        corners = 1e3 * seen.path.corners()[0]
        which = ', '.join(
            f'{k + 1} from ({_place(corners[k])}) to ({_place(corners[k + 1])}) mm'
            for k in missing[:LEGS_LISTED]
        )
        legs = f'; missing legs: {which}{", ..." if len(missing) > LEGS_LISTED else ""}'
        text = (
            f'only {100 * coverage:.1f} % of the path was recorded'
            f'{legs if missing else ""}; drive the rest, into the same recording or another one'
        )
        problems += errors(text) if coverage < MIN_COVERAGE else warnings(text)
    end = '' if alignment.last_leg_driven or coverage < COMPLETE_PATH else ', but not its end'
    return CheckOutcome(f'{100 * coverage:.1f} % of the path driven{end}', facts, problems)


def _check_parts(result: CalibrationResult) -> CheckOutcome:
    """Parts of a machine with rotary axes, as far as they were driven."""
    shares = [part.driven for run in result.runs for part in run.parts]
    missing = [k + 1 for k, share in enumerate(shares) if share < COMPLETE_PATH]
    text = ''
    if missing:
        which = ', '.join(f'part {k} ({100 * shares[k - 1]:.1f} %)' for k in missing)
        text = f'not driven to the end: {which}; drive these parts again'
    coverage = result.fit.coverage
    facts = {'coverage': coverage, 'legs_missing': len(missing)}
    words = f'{100 * coverage:.1f} % of the path of {len(shares)} parts driven'
    return CheckOutcome(words, facts, warnings(text) if coverage >= MIN_COVERAGE else ())


def _place(point: NDArray[np.float64]) -> str:
    return ', '.join(f'{v:.0f}' for v in point + 0.0)


def _missing(
    samples: Samples, path: NominalPath, alignment: Alignment, margin: float
) -> list[int]:
    """Legs of the published path of which less than half was seen."""
    legs = Legs(path.corners()[0])
    on = alignment.leg != OFF_PATH
    number = alignment.leg[on]
    published = number if alignment.published is None else alignment.published[number]
    on, number = np.flatnonzero(on)[published != OFF_PATH], published[published != OFF_PATH]
    along = legs.along(alignment.T_machine_tracker.apply(samples.xyz[on]), number)
    low, high = np.full(len(legs.length), np.inf), np.full(len(legs.length), -np.inf)
    np.minimum.at(low, number, along)
    np.maximum.at(high, number, along)
    seen = np.where(high > low, high - low, 0.0)
    long = legs.length > SHORT_LEG * margin
    return np.flatnonzero(long & (seen < LEG_SEEN * (legs.length - 2 * margin))).tolist()


FOLLOWING = Check('path', _check_path)


def _check_standstills(seen: CheckedRecording) -> CheckOutcome:
    if seen.samples is None:
        return CheckOutcome()
    speed = seen.config.rest_speed if seen.parts else seen.config.standstill_speed
    runs = find_standstills(seen.samples, speed)
    total = float((runs[:, 1] - runs[:, 0]).sum()) * seen.samples.step
    facts: dict[str, object] = {'standstills': len(runs), 'standstill_s': total}
    words = f'{len(runs)}, {total:.1f} s in all'
    noise = standstill_noise(seen.samples, runs)
    if noise is None:
        short = f'the target was at rest for {total:.1f} s only' if total < MIN_TOTAL else (
            'the points of the standstills repeat without any noise'
        )  # fmt: skip
        return CheckOutcome(words, facts, warnings(
            f'{short}: the noise is then taken from machine.yaml; keep the target at rest for '
            f'{MIN_TOTAL:g} s at the start and the end, without filtering'
        ))  # fmt: skip
    level = 1e6 * noise.noise.level
    facts |= {'noise_range_um': float(level[0]), 'noise_angle_urad': level[1:].tolist()}
    return CheckOutcome(
        f'{words}; noise {level[0]:.2f} um along the beam, {level[1]:.2f} and {level[2]:.2f} '
        f'urad across',
        facts,
    )


STANDSTILL = Check('standstill', _check_standstills)


def _check_contradictions(seen: CheckedRecording) -> CheckOutcome:
    if seen.result is not None:
        result, machine = seen.result, seen.result.tables.machine
        words = ', '.join(result.failed_gates) or 'no contradictions'
        problems = errors(*result.failed_gates) + warnings(*result.warnings)
        return CheckOutcome(f'{machine.name}, chain {machine.chain}: {words}', {}, problems)
    if seen.machine is None or seen.run is None:
        return CheckOutcome()
    findings = seen.findings
    doubtful = errors(*words_of(findings, GATE)) + warnings(*words_of(findings, WARNING))
    words = ', '.join(f.check for f in findings) or 'no contradictions'
    return CheckOutcome(f'{seen.machine.name}, chain {seen.machine.chain}: {words}', {}, doubtful)


CONTRADICTION = Check('machine', _check_contradictions)


def _check_forecast(seen: CheckedRecording) -> CheckOutcome:
    if seen.result is not None:
        return _known_of_axes(seen.result)
    run = seen.run
    if run is None or run.pieces.standstill or seen.nodes is None:
        return CheckOutcome()
    setup = Setup.of(run.machine, run.pose.translation, run.noise)
    with one_thread():
        outlook = forecast_of_runs([run], dict(seen.nodes), setup, run.pieces.end)
        expected = planned_systematic(outlook).expected
    unseen = outlook.not_identifiable
    facts = {
        'mean_grid_u_um': 1e6 * outlook.mean_grid_u,
        **expected.to_dict(),
        'not_identifiable': list(unseen),
        'mean_u': {
            name: float(np.sqrt(np.mean(u**2)))
            for name, u in outlook.u.items()
            if name not in unseen
        },
    }
    words = f'{expected.expanded_words}\n{expected.forecast_words}'
    if unseen:
        words += f'\nnot shown by this path: {", ".join(map(str, unseen))}'
    loose = ', '.join(map(str, outlook.loose_nodes))
    doubt = f'parts of {loose} will only be interpolated: no line passes there' if loose else ''
    return CheckOutcome(words, {'forecast': facts}, warnings(doubt))


def _known_of_axes(result: CalibrationResult) -> CheckOutcome:
    """How well a calibration of this recording knows the errors, and what it does not see."""
    tables, unseen = result.tables, list(result.not_identifiable)
    mean_u = {
        name: float(np.sqrt(np.mean(table.u**2)))
        for name, table in tables.motions.items()
        if table.identifiable
    }
    words = [f'u of the motions, k = 1, rms over the nodes: {_sizes(mean_u)}']
    if unseen:
        words.append(f'not shown by these parts: {", ".join(unseen)}')
        words += result.needs
    facts = {'not_identifiable': unseen, 'mean_u': mean_u}
    return CheckOutcome('\n'.join(words), {'forecast': facts})


def _sizes(mean_u: Mapping[str, float]) -> str:
    """Largest standard uncertainties of translations and rotations."""
    found = []
    for kinds, unit in (('XYZ', 'um'), ('ABC', 'urad')):
        own = {n: u for n, u in mean_u.items() if n[1] in kinds}
        if own:
            worst = max(own, key=own.__getitem__)
            found.append(f'{1e6 * own[worst]:.2f} {unit} at most ({worst})')
    return ', '.join(found) or 'none is seen'


FORECAST = Check('forecast', _check_forecast)


CHECKS: tuple[Check, ...] = (
    CONTENT,
    RATE,
    GAPS,
    CLOCK,
    BEAM,
    STANDSTILL,
    FOLLOWING,
    CONTRADICTION,
    FORECAST,
)
"""In the order in which they are shown; a further one is one file and one line here."""


@dataclass(frozen=True)
class CheckReport(ResultDocument):
    """What is to be known of a recording before the tracker is dismounted."""

    usable: bool = stated('a calibration would take the recording')
    problems: tuple[Problem, ...] = stated('errors first')
    topics: Mapping[str, str] | None = optional('types of messages by topic')
    samples: int | None = optional('samples received')
    left_out: tuple[Any, ...] | None = optional('lines of a text table that are not samples')
    rate_hz: float | None = optional('usual rate', 'Hz')
    duration_s: float | None = optional('from the first to the last sample', 's')
    spacing_mm: float | None = optional('distance of samples at the top feed', 'mm')
    gaps: int | None = optional('pauses in which samples are missing')
    lost_share: float | None = optional('share of the samples that are missing')
    longest_gap_s: float | None = optional('longest pause', 's')
    first_stamp: str | None = stated('UTC; null: stamps tell no date', default=None)
    clock_set: int | None = optional('how often the clock of the stamps was set')
    jitter: float | None = optional('usual deviation of an interval, over the median')
    beam_breaks: int | None = optional('breaks while the target moved')
    without_beam: int | None = optional('points in the origin of the tracker')
    beam_m: tuple[float, float] | None = optional('shortest and longest beam', 'm')
    coverage: float | None = optional('driven share of the path length')
    legs_missing: int | None = optional('legs of which less than half was seen')
    standstills: int | None = optional('stops')
    standstill_s: float | None = optional('their duration', 's')
    noise_range_um: float | None = optional('noise along the beam in standstills', 'um')
    noise_angle_urad: tuple[float, ...] | None = optional('of both angles', 'urad')
    forecast: Mapping[str, Any] | None = optional('what a calibration would know')
    name: str = ''
    checked: Mapping[str, CheckOutcome] = field(default_factory=dict)

    @property
    def exit_code(self) -> int:
        """0, or 3 if the recording is not usable."""
        return 0 if self.usable else InputError.exit_code


def check(
    source: str,
    machine: Machine | None = None,
    config: CalibrationConfig | None = None,
    given: ReadingOptions = AS_IT_IS,
) -> CheckReport:
    """Ask a recording whether it can be used.

    Parameters
    ----------
    source : str
        A bag, or a table of samples as text.
    given : ReadingOptions
        How it is read.

    Raises
    ------
    ConfigError
        If there is no such file or folder.
    """
    seen = look(source, machine, config or CalibrationConfig(), given)
    checked = {c.name: c.ask(seen) for c in CHECKS}
    every = [replace(p, check=n) for n, outcome in checked.items() for p in outcome.problems]
    facts = {k: v for outcome in checked.values() for k, v in outcome.facts.items()}
    return CheckReport(
        all(p.severity != ERROR for p in every),
        tuple(sorted(every, key=lambda p: p.severity != ERROR)),
        **facts,
        name=source,
        checked=checked,
    )


def format_check(report: CheckReport) -> str:
    """Return the text for a terminal: the answer, what to expect, what is wrong, the table."""
    wrong = sum(p.severity == ERROR for p in report.problems)
    doubtful = len(report.problems) - wrong
    counted = [
        f'{count} {word}{"s" if count > 1 else ""}'
        for count, word in ((wrong, 'error'), (doubtful, 'warning'))
        if count
    ]
    answer = 'usable' if report.usable else 'NOT USABLE'
    lines = [f'{report.name}: {answer}{", " if counted else ""}{", ".join(counted)}']
    expected = report.checked.get(FORECAST.name, CheckOutcome()).words
    lines += [*expected.splitlines(), '']
    lines += [f'{p.severity.upper()} {p.check}: {p.what}' for p in report.problems]
    lines += [''] if report.problems else []
    width = max(len(name) for name in report.checked)
    lines += [
        f'{name:<{width}}  {result.words}'
        for name, result in report.checked.items()
        if result.words and name != FORECAST.name
    ]
    return '\n'.join(lines)

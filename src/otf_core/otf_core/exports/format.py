# SPDX-License-Identifier: Apache-2.0
"""What an export is: the bytes of its files, the error that its values hold, and what remains."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.chain import displacement, nominal_position
from otf_core.model.evaluation import covered_grid, driven_positions, without_rigid_motion
from otf_core.model.expanded import figure
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES
from otf_core.model.tables import ErrorTables
from otf_core.prediction.absorbed import offset_bound
from otf_core.prediction.calibration_document import CalibrationDocument, Headline
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.predict import Predictor
from otf_core.prediction.volumetric import VOLUME_PLACES

# What an export is: the bytes of its files, and the error that its values hold.

Field = Callable[[Array], Array]
"""Errors (n, 3), m, at positions (n, 3), m."""

MARK = 'otf export'
"""Stands in every file: what does not hold it is somebody else's and never overwritten."""
MARK_BYTES = 4000
"""Bytes at either end of a file in which the mark stands."""
ERROR, CORRECTION = 'error', 'correction'


ANY_AXES, THREE_AXES, LINES = 'any axes', 'three linear axes', 'lines of rotary axes'
"""What a format can hold: something of every axis, a volume over X, Y and Z, or where rotary axes
lie."""


@dataclass(frozen=True)
class Request:
    """What is to be exported.

    Attributes
    ----------
    name : str
        Name of the file to write, without folder.
    sign : str, optional
        'error' or 'correction': what the control takes the values for, where its manual leaves
        that open.
    points : int, optional
        Points per axis, where a format resamples the tables.
    """

    content: CalibrationDocument
    name: str
    sign: str | None = None
    points: int | None = None

    @property
    def factor(self) -> float:
        """1 where values are errors, -1 where they are corrections."""
        return -1.0 if self.sign == CORRECTION else 1.0

    @property
    def unseen_words(self) -> tuple[str, ...]:
        """Which errors are zero because the calibration could not see them; empty if none."""
        names = Predictor.of(self.content).not_seen
        if not names:
            return ()
        bound = offset_bound(self.content.tables.machine, names).sentence
        return (
            f'zero because the calibration does not determine them: {", ".join(names)}; their '
            f'influence with another tool is unknown',
            *((bound,) if bound else ()),
        )

    def header(self, fmt: Format) -> list[str]:
        """Lines that say what the file is: machine, run, target, sign, what it does not hold.

        Safe in a comment: what cannot be printed, such as a line break, is a blank.
        """
        machine = self.content.tables.machine
        run = self.content.run_id or 'unknown'
        lines = [
            f'{MARK} {fmt.name}: machine {machine.name}, chain {machine.chain}, run {run}',
            f'measured at the target offset {offset_words(machine)}',
            f'sign: {fmt.sign_of(self)}',
            f'values: {fmt.value_words}',
            f'not in this file: {fmt.lacks}',
            *self.unseen_words,
        ]
        return list(map(printable, lines))


@dataclass(frozen=True)
class ExportedFiles:
    """Files of an export.

    Attributes
    ----------
    files : mapping of file name to bytes
        The one that ``--out`` names first.
    held : callable
        Error that a control takes off which reads these files, values rounded as written.
    remarks : tuple of str
        What the user has to know or do.
    """

    files: Mapping[str, bytes]
    held: Field
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Format:
    """How one control or program takes error tables.

    Attributes
    ----------
    name : str
        As given on the command line.
    make : callable
        Makes the files of a request that was checked; ConfigError if the format cannot hold it.
    value_words : str
        What a value is: that of a table, or a mean over the volume.
    sign_words : str
        What the sign of the values is; if there is a choice, what follows the sign named.
    lacks : str
        What of the tables the format cannot hold, in words.
    holds : str
        ``ANY_AXES``, ``THREE_AXES`` or ``LINES``.
    sign_is_asked : bool
        True where the manual does not say whether values are errors or corrections.
    takes_points : bool
        True where it samples the tables anew, with as many points per axis as are asked for.
    """

    name: str
    make: Callable[[Format, Request], ExportedFiles]
    value_words: str
    sign_words: str
    lacks: str
    holds: str = ANY_AXES
    sign_is_asked: bool = False
    takes_points: bool = False

    def sign_of(self, request: Request) -> str:
        """State what the values are, as a sentence."""
        if not self.sign_is_asked:
            return self.sign_words
        meaning = 'errors (actual minus nominal)'
        if request.sign == CORRECTION:
            meaning = 'corrections (nominal minus actual)'
        return f'values are {meaning}, as named by --sign {request.sign}{self.sign_words}'

    def export(self, request: Request) -> ExportedFiles:
        """Make the files.

        Raises
        ------
        ConfigError
            For a machine that the format cannot hold, a missing or needless sign, points that mean
            nothing; says what to give.
        """
        self.check_machine(request.content.tables.machine, f'--format {self.name}')
        if self.sign_is_asked and request.sign is None:
            raise ConfigError(
                f'--sign: {self.name} needs it: its manual does not state whether the control '
                f'interprets values as'
                f' {ERROR} (actual minus nominal) or as {CORRECTION} (added to the command); '
                f'test it with one table of 0.1 mm on your machine, then give '
                f'--sign {ERROR} or --sign {CORRECTION}'
            )
        if not self.sign_is_asked and request.sign is not None:
            raise ConfigError(f'--sign: the sign of {self.name} is fixed; leave it out')
        if not self.takes_points and request.points is not None:
            raise ConfigError(
                f'--points: {self.name} holds the nodes of the tables themselves; leave it out'
            )
        if request.points is not None and request.points < 2:
            raise ConfigError(f'--points: {request.points}; at least 2')
        return self.make(self, request)

    def check_machine(self, machine: Machine, asked: str) -> None:
        """Refuse a machine that the format cannot hold; ConfigError begins with what was asked."""
        if self.holds == THREE_AXES and machine.axis_names != AXES:
            raise ConfigError(
                f'{asked}: holds three linear axes only, and the machine has '
                f'{", ".join(machine.axis_names)}; use isg, etalon, linuxcnc or sinumerik-enc'
            )
        if self.holds == LINES and not machine.rotary_names:
            raise ConfigError(f'{asked}: the chain {machine.chain} has no rotary axis')


LINE_WORDS = (
    'mean over the volume of the error in this direction at this position of the axis, zero at '
    'the reference position; rotations act in it with their mean lever arms to the target, so it '
    'differs from the table of the positioning or straightness error'
)
"""What a value is of formats that hold one course per axis."""
POINT_WORDS = 'error vector of the target at the point, rotations with their lever arms in it'
TABLE_WORDS = 'nodes of the error tables themselves'
POSITION_WORDS = (
    'only the position of the tool is corrected, by the linear axes; its orientation keeps its '
    'error'
)
WORKPIECE_WORDS = (
    'no table contains a rigid displacement of the workpiece: set the workpiece zero anew with '
    'the compensation switched on; an error of the target offset is also an error of the centres'
)


def offset_words(machine: Machine) -> str:
    """State the target offset: '(0.000000, 0.000000, -150.000000) mm'."""
    return f'({", ".join(f"{1e3 * v:.6f}" for v in machine.target_offset)}) mm'


def frame_words(machine: Machine) -> list[str]:
    """Lines that say how errors of motions act, for formats that hold them."""
    linear = ' of linear axes' if machine.rotary_names else ''
    levers = (
        f'rotations{linear} act about the machine zero carried along by the axes; target at '
        f"{offset_words(machine)} from it at the axes' zero"
    )
    if not machine.rotary_names:
        return [levers]
    lines = [
        levers,
        POSITION_WORDS,
        'errors are those of the target relative to the table, at the programmed angle, in the '
        'directions X, Y, Z of the side of the axis towards the bed, and act about the centre',
        'location errors move the line of the axis: X0C along X, A0C about X through the centre',
        'datum: machine and table frames coincide where all axes are at zero, and rotary axes '
        'have no error at 0 degrees: keep their zero positions',
        WORKPIECE_WORDS,
    ]
    for name in machine.rotary_names:
        axis = machine.axes[name]
        assert axis.direction is not None
        direction, centre = (
            ', '.join(f'{v + 0.0:.9g}' for v in values)
            for values in (axis.direction, [1e3 * v for v in axis.centre])
        )
        lines.append(
            f'{name}: for a growing angle the target turns right-handed relative to the table '
            f'about ({direction}), about the line through ({centre}) mm (all axes at zero)'
        )
    return lines


def workpiece_remarks(machine: Machine) -> tuple[str, ...]:
    """What the user of formats that hold motions of rotary axes has to do."""
    return (POSITION_WORDS, WORKPIECE_WORDS) if machine.rotary_names else ()


def printable(text: str) -> str:
    """Text in one line: a blank for whatever cannot be printed."""
    return ''.join(c if c.isprintable() else ' ' for c in text)


def is_export(path: Path) -> bool:
    """Return whether a file was written by an export."""
    try:
        content = path.read_bytes()
    except OSError:
        return False
    mark = MARK.encode()
    return mark in content[:MARK_BYTES] or mark in content[-MARK_BYTES:]


# The volumetric error that remains when a control takes off what a format holds.

POINTS_BETWEEN, FEWER_POINTS = 13, 6
"""Points per axis between those of the volumetric error, few of them at nodes: up to three axes,
and more."""


@dataclass(frozen=True)
class RemainingError:
    """Volumetric error on the points on which a calibration states it, rigid motion removed.

    Attributes
    ----------
    points : int
        Those of the calibration.
    before_mean, before_max : float
        m; length of the error vectors by the tables: the figures of the calibration.
    after_mean, after_max : float
        m; the same less what the file holds.
    between_max : float
        m; largest remainder on a finer grid over the range of the tables, between the nodes too.
    wide : float
        m; expanded uncertainty that the calibration states for the mean; zero if unknown.
    """

    points: int
    before_mean: float
    before_max: float
    after_mean: float
    after_max: float
    between_max: float
    wide: float = 0.0

    @property
    def words(self) -> str:
        """One line."""
        share = 100 * (1 - self.after_mean / self.before_mean) if self.before_mean > 0 else 0.0
        change = f'{abs(share):.0f} % {"less" if share >= 0 else "more"}'
        worse = (
            '; the errors that this file removes cancel part of those that it cannot hold: use it '
            'only together with a compensation of those'
            if share < -0.5
            else ''
        )
        return (
            f'volumetric error by the tables, {self.points} points as in the calibration: mean '
            f'{self._um(self.before_mean)}, largest {self._um(self.before_max)}; this file leaves '
            f'mean {self._um(self.after_mean)} ({change}), largest '
            f'{self._um(self.after_max)}, between these points up to {self._um(self.between_max)}'
            f'{worse}'
        )

    def _um(self, value: float) -> str:
        """A length, as many digits as its uncertainty leaves; to 0.01 um where that is unknown."""
        return f'{figure(1e6 * value, 1e6 * self.wide)} um'

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, um."""
        sizes = {k: v for k, v in asdict(self).items() if k not in ('points', 'wide')}
        return {'points': self.points, **{f'{k}_um': 1e6 * v for k, v in sizes.items()}}


def remaining_error(
    tables: ErrorTables, held: Field, headline: Headline | None = None
) -> RemainingError:
    """Forecast what compensation by a file leaves.

    Parameters
    ----------
    held : callable
        Error that the control takes off, m.
    headline : Headline, optional
        Of the calibration; decides how many digits are stated.
    """
    machine = tables.machine
    q, few = driven_positions(tables, VOLUME_PLACES), len(machine.axis_names) <= 3
    ends = np.array(table_ranges(tables))
    finer = covered_grid(machine, ends, POINTS_BETWEEN if few else FEWER_POINTS)

    def lengths(field: Array, q: Array) -> Array:
        rest = without_rigid_motion(field, nominal_position(machine, q))
        return np.asarray(np.linalg.norm(rest, axis=1))

    error = displacement(tables, q)
    before, after = lengths(error, q), lengths(error - held(q), q)
    between = lengths(displacement(tables, finer) - held(finer), finer)
    wide = headline.expanded['mean'] if headline else 0.0
    sizes = (before.mean(), before.max(), after.mean(), after.max(), between.max(), wide)
    return RemainingError(len(q), *map(float, sizes))

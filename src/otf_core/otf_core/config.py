# SPDX-License-Identifier: Apache-2.0
"""Parameters: each in one frozen dataclass field with default, unit, bounds and meaning.

Command line, nodes and documentation read the same fields, so their defaults cannot differ.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from otf_core.errors import ConfigError

OTF, STANDSTILL = METHODS = ('otf', 'standstill')
"""Of calibration: on the fly, or from the stops at the corner points."""
POINTS = 'points'
"""Method of pairs of nominal and measured positions, which are no recording."""
AUTO, NONE = 'auto', 'none'
"""Effects to take off a calibration: those that a diagnosis finds; none."""


KINDS = {float: 'a number', int: 'a whole number', bool: 'true or false', str: 'a text',
         tuple: 'a list of texts'}  # fmt: skip


def parameter(
    default: Any,
    meaning: str,
    unit: str = '',
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """Declare one dataclass field with its meaning, unit and closed bounds."""
    metadata = {'meaning': meaning, 'unit': unit, 'low': low, 'high': high, 'choices': choices}
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True)
class ParameterInfo:
    """One parameter: name, default, meaning, unit, bounds (None: unbounded), choices."""

    name: str
    default: Any
    meaning: str
    unit: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]

    def check(self, value: Any) -> Any:
        """Return the value in the type of the default; ConfigError if it does not fit."""
        kind = type(self.default)
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if kind is tuple and isinstance(value, list) and all(isinstance(v, str) for v in value):
            value = tuple(value)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise ConfigError(f'{self.name}: expected {KINDS[kind]}, got {value!r}')
        if kind is float and not math.isfinite(value):
            raise ConfigError(f'{self.name}: {value} is not finite')
        if (self.low is not None and value < self.low) or (
            self.high is not None and value > self.high
        ):
            unit = f' {self.unit}' if self.unit else ''
            raise ConfigError(
                f'{self.name}: {value:g} is out of range [{self.low}, {self.high}]{unit}'
            )
        if self.choices and value not in self.choices:
            raise ConfigError(f'{self.name}: {value!r}; possible: {", ".join(self.choices)}')
        return value


def _described(name: str, field: dataclasses.Field[Any]) -> str:
    """Return one parameter in the form of numpydoc."""
    unit, low, high = (field.metadata[key] for key in ('unit', 'low', 'high'))
    bounds = '' if low is None or high is None else f', {low:.10g} to {high:.10g}'
    head = f'{name}, {unit}' if unit else name
    return f'{head}\n    {field.metadata["meaning"]} (default {field.default!r}{bounds})'


class Parameters:
    """Base of the parameter dataclasses: checks every field when built.

    The fields of a class are added to its description, so that ``help`` shows what they mean.
    """

    def __init_subclass__(cls) -> None:
        """Describe the fields where the class describes itself."""
        fields = {n: f for n, f in vars(cls).items() if isinstance(f, dataclasses.Field)}
        rows = [_described(f'{n} : {cls.__annotations__[n]}', f) for n, f in fields.items()]
        text, mark, examples = inspect.cleandoc(cls.__doc__ or '').partition('\nExamples\n')
        heading = ['Attributes', '----------'] if rows else []
        cls.__doc__ = '\n'.join([text, *heading, *rows, mark + examples]).rstrip()

    @classmethod
    def infos(cls, *only: str) -> Iterator[ParameterInfo]:
        """Yield what is known of every parameter, or of ``only`` some."""
        for f in dataclasses.fields(cls):  # type: ignore[arg-type]  # subclasses are dataclasses
            if not only or f.name in only:
                yield ParameterInfo(f.name, f.default, **f.metadata)

    def __post_init__(self) -> None:
        """Check types, bounds and choices."""
        for info in self.infos():
            object.__setattr__(self, info.name, info.check(getattr(self, info.name)))


CREEPING = 0.5e-3
"""m/s; where the linear axes follow a rotation the target creeps at some mm/s while the machine
moves, and slower still when the move begins and ends: this is no noise of the tracker."""


@dataclass(frozen=True)
class CalibrationConfig(Parameters):
    """How samples become error tables.

    Examples
    --------
    >>> otf_core.CalibrationConfig(piece_length=0.004).piece_length
    0.004
    >>> otf_core.CalibrationConfig(piece_length=4.0)  # mm?
    Traceback (most recent call last):
    otf_core.errors.ConfigError: piece_length: 4 is out of range [0.0001, 0.1] m
    """

    corner_exclusion: float = parameter(
        0.008,
        'path length left out at both ends of every leg: acceleration, rounding',
        'm',
        0,
        0.2,
    )
    piece_length: float = parameter(
        0.008, 'samples are averaged over path pieces of about this length', 'm', 1e-4, 0.1
    )
    standstill_speed: float = parameter(
        0.002, 'below this speed the target counts as standing still', 'm/s', 1e-5, 0.1
    )
    match_tolerance: float = parameter(
        0.002, 'largest distance of measured corners and lines from the nominal path', 'm',
        1e-5, 0.05,
    )  # fmt: skip
    alignment_stop: float = parameter(
        1e-9, 'fine alignment ends when the pose moves the points by less', 'm', 1e-12, 1e-5
    )
    max_iterations: int = parameter(
        20, 'limit of the iterations of alignment and of solution', '', 1, 200
    )
    outlier_limit: float = parameter(
        8.0, 'samples further from the running median than this many robust deviations '
        'are left out', '', 3, 100,
    )  # fmt: skip
    unidentifiable_above: float = parameter(
        1e-4, 'a combination of errors more uncertain than this counts as not identifiable',
        'm or rad', 1e-7, 1.0,
    )  # fmt: skip
    reversal: str = parameter(
        'auto', 'errors that differ between forward and backward travel: none, one value per '
        'motion, tables along the axis; auto: chosen on held-out legs',
        choices=('auto', 'none', 'constant', 'tables'),
    )  # fmt: skip

    @property
    def rest_speed(self) -> float:
        """Speed below which a target that rotary axes may move counts as standing still, m/s."""
        return min(self.standstill_speed, CREEPING)


@dataclass(frozen=True)
class PlannerConfig(Parameters):
    """The nominal path: which lines and diagonals, how often, how fast.

    Examples
    --------
    >>> otf_core.PlannerConfig(passes=1, feed=0.1).end_dwell
    3.0
    """

    passes: int = parameter(2, 'laps of the path; every second one runs backwards', '', 1, 20)
    feed: float = parameter(0.25, 'feed of the first lap', 'm/s', 1e-4, 5.0)
    feed_ratio: float = parameter(
        0.67, 'feed of every second lap, as a ratio to the first', '', 0.1, 1.0
    )
    corner_dwell: float = parameter(0.2, 'standstill at every corner point', 's', 0, 60)
    end_dwell: float = parameter(3.0, 'standstill at the start and the end point', 's', 0, 600)
    margin: float = parameter(0.0, 'distance kept from the ends of the axis ranges', 'm', 0, 1)
    levels: int = parameter(3, 'planes per axis direction in which diagonals lie', '', 2, 9)


@dataclass(frozen=True)
class SimulationConfig(Parameters):
    """The simulated cell: truth machine, drive, tracker. The seed determines all random draws.

    Examples
    --------
    >>> otf_core.SimulationConfig(rate=100.0, error_size=5e-5).seed
    1
    """

    seed: int = parameter(1, 'seed of all random numbers of the cell', '', 0, 2**31 - 1)
    rate: float = parameter(500.0, 'tracker samples per second', 'Hz', 1, 5000)
    acceleration: float = parameter(2.0, 'acceleration of the drives', 'm/s^2', 0.01, 100)
    error_size: float = parameter(
        2e-5, 'mean volumetric error of the truth machine, where no tables are given', 'm', 0, 1e-2
    )
    correlated_share: float = parameter(
        0.5, 'share of the noise variance that is correlated in time', '', 0, 1
    )
    correlation_time: float = parameter(
        0.3, 'correlation time of that share (first-order Gauss-Markov)', 's', 1e-3, 100
    )
    resolution: float = parameter(
        0.0, 'recorded coordinates are rounded to multiples of this; 0: not rounded', 'm', 0, 1e-3
    )
    packet_loss: float = parameter(
        0.0, 'share of samples lost, in whole packets of a third of a second', '', 0, 0.9
    )
    clock_drift: float = parameter(
        1.8e-5, 'rate error of the tracker clock against true time', '', -1e-3, 1e-3
    )


@dataclass(frozen=True)
class ForecastConfig(Parameters):
    """Conditions of a forecast: sampling rate, drives, permitted tracker positions.

    Examples
    --------
    >>> otf_core.ForecastConfig(rate=1000.0).acceleration
    2.0
    """

    rate: float = parameter(500.0, 'tracker samples per second', 'Hz', 1, 5000)
    acceleration: float = parameter(2.0, 'acceleration of the drives', 'm/s^2', 0.01, 100)
    error_size: float = parameter(
        2e-5, 'expected mean volumetric error, of motions that are assumed to be smooth', 'm',
        1e-7, 1e-1,
    )  # fmt: skip
    grid: int = parameter(7, 'points per axis of the evaluation grid', '', 2, 15)
    min_range: float = parameter(
        0.15, 'shortest beam: tracker positions nearer to the path are left out', 'm', 0.01, 10
    )
    max_range: float = parameter(
        20.0, 'longest beam: tracker positions further away are left out', 'm', 0.1, 100
    )


@dataclass(frozen=True)
class ReadingConfig(Parameters):
    """How a recording is read where it does not say so itself."""

    topic: str = parameter(
        '', 'topic of the samples in a bag, in any frame; empty: /tracker/point, else the only '
        'topic of points'
    )  # fmt: skip
    path_topic: str = parameter(
        '', 'topic of the path in a bag, in any frame; empty: /planner/path, else the only path'
    )
    recover: bool = parameter(False, 'skip damaged parts inside a bag')


@dataclass(frozen=True)
class DiagnosisConfig(Parameters):
    """What a diagnosis considers."""

    exclude: tuple[str, ...] = parameter((), 'effects that are not considered')
    own_causes: str = parameter(
        '', 'folder of named empirical effects (.yaml) beside the catalogue; relative to the file'
    )


@dataclass(frozen=True)
class WritingConfig(Parameters):
    """What is written of a calibration beside error_tables.json and error_tables.csv."""

    report: bool = parameter(True, 'write report.html')

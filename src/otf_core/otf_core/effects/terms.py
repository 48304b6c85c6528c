# SPDX-License-Identifier: Apache-2.0
"""What an effect may depend on, and its linear terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import Enum

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.model.machine import Machine
from otf_core.model.signals import Part
from otf_core.model.tables import ErrorTables

Shape = Mapping[str, float]


@dataclass(frozen=True)
class Turning:
    """What the state of a machine with rotary axes has besides, one row per measured point.

    All vectors are in the frame of the link that carries the tracker.

    Attributes
    ----------
    point : ndarray, shape (n, 3), m
        Nominal position of the target.
    rates : ndarray, shape (n, k), m/s and rad/s
        Speeds of the axes.
    motions : ndarray, shape (n, 3, k, 6)
        Displacement of the target per unit of the six motions of every axis; zero of axes that
        do not move it in view of the tracker.
    link : ndarray, shape (n, 3, 3)
        Rotates coordinates of the link that carries the target.
    part : ndarray of int, shape (n,)
        Number of the part.
    target : ndarray of int, shape (n,)
        Number of the target among those of the machine.
    again : ndarray of int, shape (n,)
        How many parts before had the same target.
    facing : ndarray, shape (n, 3)
        Unit vector in which the target looks if it looked to the tracker when its part began.
    spread : ndarray, shape (n, k), m and rad
        Standard deviation of the positions that a point stands for; zero of samples.
    """

    point: Array
    rates: Array
    motions: Array
    link: Array
    part: Index
    target: Index
    again: Index
    facing: Array
    spread: Array

    def rows(self, rows: slice) -> Turning:
        """Return some of the points."""
        return Turning(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


POSITIONING = {a: k for k, a in enumerate('XYZABC')}
"""Which of its six motions is along, or about, the direction of an axis."""


@dataclass(frozen=True)
class State:
    """What an effect may depend on, one row per measured point.

    Attributes
    ----------
    q : ndarray, shape (n, 3), m
        Programmed axis positions.
    direction : ndarray, shape (n, 3)
        Unit travel direction of the leg, also while standing.
    speed : ndarray, shape (n,), m/s
        Along the path.
    time : ndarray, shape (n,), s
        Since the start of the recording.
    from_corner, to_corner : ndarray, shape (n,), m
        Path length since the last corner and to the next one.
    side : ndarray, shape (n, 3)
        Sign of the travel of each axis, of its last travel where it stands; 0 before its first.
    before, after : ndarray, shape (n, 3)
        Unit directions of the legs before and after; the own direction at the ends of the path.
    beam : ndarray, shape (n, 3), m
        From the tracker to the target, machine frame.
    R_machine_tracker : ndarray, shape (3, 3)
        Rotates tracker coordinates to machine coordinates; its third column is the tracker's
        standing axis.
    nodes : mapping of axis to ndarray, m
        Table nodes.
    tables : ErrorTables, optional
        Error tables of the machine, where they are known.
    duration : float, s
        Length of the recording; 0 stands for the time of the last point.
    more : mapping of str to ndarray, shape (n,)
        Further inputs of free forms by their names, see ``inputs``: what happened before on the
        path, signals recorded beside the samples.
    turning : Turning, optional
        Of a machine with rotary axes: there q, direction, side, before and after have one column
        for every axis, and directions count a rotation as travel on a radius.
    """

    machine: Machine
    q: Array
    direction: Array
    speed: Array
    time: Array
    from_corner: Array
    to_corner: Array
    side: Array
    before: Array
    after: Array
    beam: Array
    R_machine_tracker: Array
    nodes: Mapping[str, Array]
    tables: ErrorTables | None = None
    duration: float = 0.0
    more: Mapping[str, Array] = field(default_factory=dict)
    turning: Turning | None = None

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.q)

    @property
    def end(self) -> float:
        """Time of the end of the recording, s."""
        return self.duration or float(self.time.max(initial=0.0))

    def part(self, rows: slice) -> State:
        """Return some of the points of the same recording."""
        per_point = ('q', 'direction', 'speed', 'time', 'from_corner', 'to_corner', 'side')
        chosen = {n: getattr(self, n)[rows] for n in (*per_point, 'before', 'after', 'beam')}
        turning = self.turning and self.turning.rows(rows)
        return replace(
            self, duration=self.end, more=Part(self.more, rows), turning=turning, **chosen
        )

    @property
    def point(self) -> Array:
        """Nominal position of the target, shape (n, 3), m."""
        return self.q if self.turning is None else self.turning.point

    def by_axes(self, values: Array) -> Array:
        """Displacements by an error of the position of each axis, shape (n, 3, k), m.

        Parameters
        ----------
        values : ndarray, shape (n, k), m and rad
        """
        if self.turning is None:
            return np.asarray(values[:, :, None] * np.eye(3))
        names = self.machine.axis_names
        own = [self.turning.motions[:, :, k, POSITIONING[a]] for k, a in enumerate(names)]
        return np.stack(own, axis=2) * values[:, None, :]

    @property
    def scaled(self) -> Array:
        """Positions scaled to [-1, 1] over the axis ranges, shape (n, k)."""
        low, high = self.machine.lower, self.machine.upper
        return np.asarray((2.0 * self.q - low - high) / (high - low))

    @property
    def travel(self) -> Array:
        """Positions less the reference position of each axis: zero, else its minimum; (n, k)."""
        low, high = self.machine.lower, self.machine.upper
        return np.asarray(self.q - np.where((low <= 0.0) & (high >= 0.0), 0.0, low))

    @property
    def velocity(self) -> Array:
        """Speeds of the axes, shape (n, k), m/s and rad/s."""
        if self.turning is None:
            return np.asarray(self.speed[:, None] * self.direction)
        return self.turning.rates


@dataclass(frozen=True)
class Terms:
    """Linear terms of an effect for one shape.

    Attributes
    ----------
    names : tuple of str
        One name per coefficient, e.g. 'B_X'.
    units : tuple of str
        Unit of each coefficient.
    axes : tuple of str
        Machine axis each coefficient belongs to; '' for none.
    columns : ndarray, shape (n, 3, k)
        Displacement of the measured point per unit of each coefficient, machine frame.
    orders : tuple of float
        Order of each as a function, where the higher ones are expected to be smaller; empty if
        all are alike.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    axes: tuple[str, ...]
    columns: Array
    orders: tuple[float, ...] = ()

    @classmethod
    def of(
        cls, names: Sequence[str], unit: str, columns: Array, axes: Sequence[str] = ()
    ) -> Terms:
        """Terms of one unit; of no axis where none are given."""
        names = tuple(names)
        return cls(names, (unit,) * len(names), tuple(axes) or ('',) * len(names), columns)

    @classmethod
    def joined(cls, *parts: Terms) -> Terms:
        """Terms of several effects one after the other."""
        names, units, axes = (
            tuple(v for p in parts for v in getattr(p, key)) for key in ('names', 'units', 'axes')
        )
        return cls(names, units, axes, np.concatenate([p.columns for p in parts], axis=2))


class BelongsTo(Enum):
    """The part of a calibration that takes an effect up."""

    EFFECTS = 'taken off as an effect'
    TABLES = 'the tables follow it more finely; nothing is removed'
    REVERSAL = 'the calibration chooses its own tables for both senses of travel'
    NOISE = 'no displacement: it changes the noise, which every calibration judges anyway'

# SPDX-License-Identifier: Apache-2.0
"""Error tables: motions, squareness and location errors (ISO 230-1), piecewise linear.

A table is linear between its nodes and constant outside them; of an endless axis it repeats.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from otf_core.arrays import Array, Flags
from otf_core.documents import Document, stated
from otf_core.errors import ConfigError
from otf_core.model.machine import Machine


@dataclass(frozen=True)
class MotionTable(Document):
    """One error motion of one axis."""

    position: Array = stated(
        'nodes, ascending: programmed axis positions', 'm or rad', shape=('k',)
    )
    value: Array = stated(
        'actual minus nominal, target relative to table', 'm or rad', shape=('k',)
    )
    u: Array = stated(
        'standard uncertainty (k = 1) with everything that is stated', 'm or rad',
        shape=('k',), least=0.0, default=None,
    )  # fmt: skip
    identifiable: bool = stated('false: the data cannot see it, its values are 0', default=True)
    node_identifiable: Flags | None = stated(
        'false: the value continues smoothly what the data determine', shape=('k',),
        default=None, sparse=True,
    )  # fmt: skip
    u_run: Array | None = stated(
        'standard uncertainty by noise and misfit of the run alone', 'm or rad', shape=('k',),
        least=0.0, default=None, sparse=True,
    )  # fmt: skip
    axis: str = stated('axis that moves', default='')
    unit: str = stated('of value and u: m or rad', default='')
    position_unit: str = stated('m or rad', default='')
    k: float | None = stated('coverage factor for 95 %', default=None)
    dof: float | None = stated('degrees of freedom; null: infinite', default=None)
    needs: str | None = stated('what would show it', default=None, sparse=True)

    def at(self, q: Array) -> Array:
        """Return the error at axis positions q (any shape, m); constant outside the nodes."""
        return np.interp(q, self.position, self.value)

    @property
    def nodes_seen(self) -> Flags:
        """Which nodes the data determine, shape (k,); all where a file does not say."""
        if self.node_identifiable is None:
            return np.full(len(self.position), self.identifiable)
        return self.node_identifiable

    def with_defaults(self) -> MotionTable:
        """The same with u where a file states none: zero; u_run is u then."""
        u = np.zeros(len(self.position)) if self.u is None else self.u
        return replace(self, u=u, u_run=u if self.u_run is None else self.u_run)


@dataclass(frozen=True)
class ScalarError(Document):
    """A squareness error, or a location error of a rotary axis."""

    value: float = stated('actual minus nominal', 'm or rad', default=0.0)
    u: float = stated(
        'standard uncertainty (k = 1) with everything that is stated', 'm or rad', least=0.0,
        default=0.0,
    )  # fmt: skip
    identifiable: bool = stated('false: the data cannot see it, its value is 0', default=True)
    u_run: float | None = stated(
        'standard uncertainty by noise and misfit of the run alone', 'm or rad', least=0.0,
        default=None, sparse=True,
    )  # fmt: skip
    k: float | None = stated('coverage factor for 95 %', default=None)
    dof: float | None = stated('degrees of freedom; null: infinite', default=None)
    needs: str | None = stated('what would show it', default=None, sparse=True)
    words: str | None = stated('the same in words', default=None, sparse=True)

    def with_defaults(self) -> ScalarError:
        """The same, with u for u_run where a file states none."""
        return self if self.u_run is not None else replace(self, u_run=self.u)


@dataclass(frozen=True)
class ErrorTables:
    """Error tables of one machine.

    Attributes
    ----------
    motions : mapping of motion name (EXX ... ECZ) to MotionTable
    squareness : mapping of C0Y, B0Z, A0Z to ScalarError
        As far as both axes are there.
    location : mapping of name, such as X0C, to ScalarError
        Of the rotary axes; empty without any.

    Examples
    --------
    >>> tables = otf_core.load_tables('bags/y-carries-the-table/truth.json').tables
    >>> q = [-0.15, 0.0, 0.15]
    >>> twice = tables.scaled(2.0)
    >>> bool((twice.motions['EXX'].at(q) == 2 * tables.motions['EXX'].at(q)).all())
    True
    """

    machine: Machine
    motions: Mapping[str, MotionTable]
    squareness: Mapping[str, ScalarError]
    location: Mapping[str, ScalarError] = field(default_factory=dict)

    def scalar(self, name: str) -> float:
        """Value of a squareness or location error, m or rad."""
        return (self.squareness[name] if name in self.squareness else self.location[name]).value

    def scaled(self, factor: float) -> ErrorTables:
        """Return the same tables with every error multiplied by a factor."""
        return replace(
            self,
            motions={k: replace(m, value=m.value * factor) for k, m in self.motions.items()},
            squareness={k: replace(s, value=s.value * factor) for k, s in self.squareness.items()},
            location={k: replace(v, value=v.value * factor) for k, v in self.location.items()},
        )

    def on(self, machine: Machine) -> ErrorTables:
        """Return the same errors of a machine that is described anew: target, ranges, tracker.

        Raises
        ------
        ConfigError
            If its chain is another: the errors would mean something else.
        """
        if machine.chain != self.machine.chain:
            raise ConfigError(
                f'tables are of a machine with the chain {self.machine.chain}, '
                f'{machine.name} has {machine.chain}: not one machine'
            )
        return replace(self, machine=machine)


def with_uncertainty(
    tables: ErrorTables, covariance: Array, run: Array | None = None
) -> ErrorTables:
    """Return the tables with the standard uncertainties of a covariance.

    Parameters
    ----------
    covariance, run : ndarray, shape (m, m), m and rad
        Of squareness and location errors and the nodes of all motions in that order: of ``u``,
        and of ``u_run``, which is the same if not given.
    """
    machine = tables.machine
    u, u_run = (
        np.sqrt(np.maximum(np.diag(c), 0.0))
        for c in (covariance, covariance if run is None else run)
    )
    squareness = {
        name: replace(tables.squareness[name], u=float(u[k]), u_run=float(u_run[k]))
        for k, name in enumerate(machine.squareness)
    }
    location = {
        name: replace(
            own, u=float(u[k]) * own.identifiable, u_run=float(u_run[k]) * own.identifiable
        )
        for k, name in enumerate(machine.location, start=len(machine.squareness))
        for own in [tables.location[name]]
    }
    motions: dict[str, MotionTable] = {}
    start = len(machine.scalars)
    for name in machine.motions:
        table = tables.motions[name]
        part = slice(start, start + len(table.position))
        seen = float(table.identifiable)
        motions[name] = replace(table, u=seen * u[part], u_run=seen * u_run[part])
        start = part.stop
    return replace(tables, motions=motions, squareness=squareness, location=location)

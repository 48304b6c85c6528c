# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a displacement of the measured point, with a name, a unit and a source.

An effect is linear in its coefficients; what it is not linear in (a period, a time constant) is
its shape. ``terms`` is the one formula: the simulator sums its columns, the fit and the diagnosis
use them as columns of the system of equations, the report quotes them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError
from otf_core.machine import Machine

Array = NDArray[np.float64]
Shape = Mapping[str, float]


@dataclass(frozen=True)
class State:
    """What an effect may depend on, one row per measured point.

    Attributes
    ----------
    machine : Machine
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
    before, after : ndarray, shape (n, 3)
        Unit directions of the legs before and after; the own direction at the ends of the path.
    beam : ndarray, shape (n, 3), m
        From the tracker to the target, machine frame.
    R_machine_tracker : ndarray, shape (3, 3)
        Rotates tracker coordinates to machine coordinates; its third column is the tracker's
        standing axis.
    nodes : mapping of axis to ndarray, m
        Table nodes.
    """

    machine: Machine
    q: Array
    direction: Array
    speed: Array
    time: Array
    from_corner: Array
    to_corner: Array
    before: Array
    after: Array
    beam: Array
    R_machine_tracker: Array
    nodes: Mapping[str, Array]

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.q)


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
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    axes: tuple[str, ...]
    columns: Array


class Effect(ABC):
    """One effect; every subclass is one file and one line in the registry."""

    name: ClassVar[str]
    """Name in files and reports (INTERFACES section 6)."""
    cause: ClassVar[str]
    equation: ClassVar[str]
    typical: ClassVar[str]
    """Typical size, with unit."""
    source: ClassVar[str]
    signature: ClassVar[str]
    """One sentence: what it looks like in data."""
    needs: ClassVar[str]
    """What measurement shows it where a run does not."""
    shape_names: ClassVar[tuple[str, ...]] = ()
    """Names of the parameters it is not linear in."""
    sample_resolution: ClassVar[bool] = False
    """True if means over path pieces wash it out."""

    def shapes(self, state: State) -> Sequence[Shape]:
        """Shapes worth trying in this run; one empty shape if there is nothing to choose."""
        return ({},)

    @abstractmethod
    def terms(self, state: State, shape: Shape) -> Terms:
        """Return the linear terms for one shape."""

    def displacement(self, state: State, parameters: Mapping[str, float]) -> Array:
        """Displacement of the measured point.

        Parameters
        ----------
        state : State
        parameters : mapping of str to float
            Coefficients by their names in ``Terms`` (missing ones are zero) and all shape names.

        Returns
        -------
        ndarray, shape (n, 3), m

        Raises
        ------
        ConfigError
            Names a parameter that is missing or unknown.
        """
        missing = [n for n in self.shape_names if n not in parameters]
        if missing:
            raise ConfigError(f'{self.name}: {missing[0]}: missing')
        terms = self.terms(state, {n: parameters[n] for n in self.shape_names})
        unknown = sorted(set(parameters) - set(terms.names) - set(self.shape_names))
        if unknown:
            known = ', '.join((*self.shape_names, *terms.names))
            raise ConfigError(f'{self.name}: {unknown[0]}: unknown; possible: {known}')
        coefficients = np.array([parameters.get(n, 0.0) for n in terms.names])
        return np.asarray(terms.columns @ coefficients)

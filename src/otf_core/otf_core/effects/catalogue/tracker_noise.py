# SPDX-License-Identifier: Apache-2.0
"""Tracker noise other than specified: level, colour or tails.

No displacement: it changes the noise that the simulated tracker adds. Range noise has the standard
deviation level_range * u_range, both angles level_angle * u_angle; the share correlated_share of
the variance is a first-order Gauss-Markov process of time constant correlation_time; the rest is
white, with Student's t of ``dof`` degrees of freedom and the same variance if dof is given.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from otf_core.effects.base import BelongsTo, Coefficients, Effect, Shape, Size, State, Terms
from otf_core.errors import ConfigError

SPECIFIED = -1.0
"""Stands for the value that the simulation has anyway."""


class TrackerNoise(Effect):
    """Level, correlation in time and tails of the tracker's noise."""

    name: ClassVar[str] = 'tracker_noise'
    cause: ClassVar[str] = 'turbulent air, long filters, a worn or dusty target, beam breaks'
    equation: ClassVar[str] = (
        'no displacement; standard deviations level * u, autocorrelation '
        'correlated_share * exp(-t / correlation_time), white rest with Student t of dof'
    )
    coefficients: ClassVar[str] = (
        'shape only: factors on u_range and u_angle, correlated share of the variance and its '
        'time constant, degrees of freedom of the tails; missing ones remain as specified'
    )
    typical: ClassVar[str] = 'level 0.5 to 3, correlated share 0.3 to 0.8 over 0.1 s to 0.5 s'
    source: ClassVar[str] = (
        'standstills of recorded trackers; ISO 10360-10:2021 for the levels that are specified'
    )
    signature: ClassVar[str] = (
        'scatter without structure; means over stretches decrease less than with white noise'
    )
    needs: ClassVar[str] = 'standstills of a second or more'
    shape_names: ClassVar[tuple[str, ...]] = (
        'level_range',
        'level_angle',
        'correlated_share',
        'correlation_time',
        'dof',
    )
    shape_units: ClassVar[tuple[str, ...]] = ('', '', '', 's', '')
    shape_defaults: ClassVar[Mapping[str, float]] = MappingProxyType(
        {
            'level_range': 1.0,
            'level_angle': 1.0,
            'correlated_share': SPECIFIED,
            'correlation_time': SPECIFIED,
            'dof': SPECIFIED,
        }
    )
    belongs_to: ClassVar[BelongsTo] = BelongsTo.NOISE
    any_axes: ClassVar[bool] = True

    def complete_shape(self, parameters: Shape) -> dict[str, float]:
        """Shape parameters with the defaults; levels and share may be zero.

        Raises
        ------
        ConfigError
            Names the parameter that is out of range.
        """
        bounds = {
            'level_range': (0.0, 1e3),
            'level_angle': (0.0, 1e3),
            'correlated_share': (0.0, 1.0),
            'correlation_time': (1e-3, 100.0),
            'dof': (2.1, 1e6),
        }
        shape = {}
        for name, (low, high) in bounds.items():
            value = float(parameters.get(name, self.shape_defaults[name]))
            if value != self.shape_defaults[name] and not low <= value <= high:
                raise ConfigError(
                    f'{self.name}: {name}: {value} is out of range [{low:g}, {high:g}]'
                )
            shape[name] = value
        return shape

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Level where it departs, else time constant, else degrees of freedom."""
        levels = {n: v for n, v in fitted.shape.items() if n.startswith('level_')}
        if levels:
            name = max(levels, key=levels.__getitem__)
            of = f'of the {name.removeprefix("level_")}'
            return (Size(of, (), '', 'times as specified', levels[name]),)
        if 'correlation_time' in fitted.shape:
            value = fitted.shape['correlation_time']
            return (Size('', (), 's', 'time over which it is correlated', value),)
        return (Size('', (), '', 'degrees of freedom of its tails', fitted.shape['dof']),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return no terms."""
        return Terms((), (), (), np.zeros((len(state), 3, 0)))

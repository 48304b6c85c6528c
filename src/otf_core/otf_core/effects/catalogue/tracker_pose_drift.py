# SPDX-License-Identifier: Apache-2.0
"""Drift of the tracker's pose: it settles, its mount creeps or bends with temperature.

delta = sum over k of (M_k + W_k x r) g_k(t): shift M and turn W about the tracker, machine axes;
r is the beam, g as in ``drift``.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.effects import drift
from otf_core.effects.action import Acting, rigid_tracker
from otf_core.effects.base import Coefficients, Shape, Size, State, Terms
from otf_core.effects.catalogue.thermal_structure_drift import translation_columns
from otf_core.effects.free import Free
from otf_core.effects.sizes import vector_size
from otf_core.model.frames import XYZ


class TrackerPoseDrift(drift.DriftingEffect):
    """Slow rigid motion of all measured points."""

    name: ClassVar[str] = 'tracker_pose_drift'
    cause: ClassVar[str] = 'tracker or its mount settles, creeps or warms up'
    equation: ClassVar[str] = '(M_k + W_k x r) g_k(t)'
    coefficients: ClassVar[str] = (
        'M_a, W_a: shift along and rotation about a reached at until; M_a_2, ...: further '
        'functions'
        ' of time; shape: time constant tau, until (0: end of the run), order of the last '
        'function'
    )
    typical: ClassVar[str] = '1 um to 10 um and 1 urad to 50 urad in a run'
    source: ClassVar[str] = (
        'ASME B89.4.19-2006 and ISO 10360-10:2021 (drift checks of laser trackers)'
    )
    signature: ClassVar[str] = 'all points rotate about the tracker with time; grows with range'
    needs: ClassVar[str] = (
        'fixed nests on the table, measured repeatedly; its shift has exactly the same effect '
        'as a drift of the structure'
    )
    any_axes: ClassVar[bool] = True

    follows: ClassVar[tuple[Acting, ...]] = (rigid_tracker,)
    switches: ClassVar[tuple[Acting, ...]] = (rigid_tracker,)
    free: ClassVar[tuple[Free, ...]] = (
        Free(
            ('time',),
            (10,),
            'the drift does not follow an exponential in time',
            (1,),
            rigid_tracker,
            zero_at=-1.0,
        ),
    )

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Shift and turn, the one that displaces more first."""
        shifts, turns = (
            [drift.value_reached(f'{part}_{a}', fitted.shape) for a in XYZ] for part in 'MW'
        )
        shift = vector_size(fitted, shifts, 'm', drift.REACHED, 'shifting')
        turn = vector_size(fitted, turns, 'rad', drift.REACHED, 'turning', 'about')
        return (turn, shift) if fitted.strongest.startswith('W') else (shift, turn)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return M_X ... W_Z: reached at ``until``; M_X_2 ...: further functions of time."""
        functions = drift.time_functions(state, shape)
        turned = np.stack([np.cross(e, state.beam) for e in np.eye(3)], axis=2)
        turns = np.concatenate([g[:, None, None] * turned for _, g in functions], axis=2)
        names = [f'{part}_{a}{suffix}' for part in 'MW' for suffix, _ in functions for a in XYZ]
        count = 3 * len(functions)
        columns = np.concatenate([translation_columns(functions), turns], axis=2)
        units = ('m',) * count + ('rad',) * count
        return Terms(tuple(names), units, ('',) * 2 * count, columns)

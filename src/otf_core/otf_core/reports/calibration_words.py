# SPDX-License-Identifier: Apache-2.0
"""Facts about a calibration that its text states in words: sign, date, squareness, volume."""

from __future__ import annotations

import numpy as np

from otf_core.calibration.result import CalibrationResult
from otf_core.model.evaluation import lattice, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.provenance import moment
from otf_core.model.tables import ErrorTables
from otf_core.version import __version__

ANGLES = {'C0Y': ('+X', '+Y', 1.0), 'B0Z': ('+X', '+Z', -1.0), 'A0Z': ('+Y', '+Z', 1.0)}
"""Directions between which a squareness error changes the angle, and the sign of the change."""
ARCSEC = np.pi / 648000


def volumetric_error(tables: ErrorTables) -> dict[str, float | int | str]:
    """Size of the error vectors that tables predict, m.

    Returns
    -------
    dict
        ``mean``, ``p95`` and ``max`` over a regular grid of ``points`` in the whole volume, its
        best rigid motion taken out.
    """
    grid = lattice(tables.machine)
    size = np.linalg.norm(without_rigid_motion(displacement(tables, grid), grid), axis=1)
    return {
        'points': len(grid),
        'mean': float(size.mean()),
        'p95': float(np.quantile(size, 0.95)),
        'max': float(size.max()),
        'rigid_motion': 'taken out',
    }


def volumetric_line(tables: ErrorTables) -> str:
    """Say how large the predicted errors are."""
    found = volumetric_error(tables)
    mean, high, most = (1e6 * float(found[key]) for key in ('mean', 'p95', 'max'))
    return (
        f'volumetric error that these tables predict on {found["points"]} points of the whole '
        f'volume: mean {mean:.2f} um, 95 % below {high:.2f} um, largest {most:.2f} um (best rigid '
        f'motion taken out)'
    )


def squareness_words(name: str, value: float) -> str:
    """Say a squareness error as an angle.

    C0Y > 0 tilts +Y to -X, B0Z > 0 tilts +Z to +X, A0Z > 0 tilts +Z to -Y.

    Parameters
    ----------
    name : str
        C0Y, B0Z or A0Z.
    value : float, rad
    """
    one, other, sign = ANGLES[name]
    change = sign * value
    mark = '-' if change < 0 else '+'
    return (
        f'angle between {one} and {other} is 90 deg {mark} {1e6 * abs(change):.1f} urad '
        f'({abs(change) / ARCSEC:.1f} arcsec)'
    )


def convention_lines(result: CalibrationResult) -> list[str]:
    """State sign and units of all numbers, and when and by what they came about."""
    lines = [
        'error = actual minus nominal, of the target relative to the table, in machine '
        'coordinates; u standard uncertainty (k = 1), U = k u (95 %)',
        'files: position in m; value, u and U in m for EX, EY, EZ, in rad for EA, EB, EC and '
        'squareness',
    ]
    dates = [moment(ns) for o in result.origin for ns in (o.first_ns, o.last_ns)]
    known = sorted(d for d in dates if d is not None)
    measured = f'measured {known[0][:19]}Z to {known[-1][:19]}Z, ' if known else ''
    return [*lines, f'{measured}calibrated by otf_core {__version__}']

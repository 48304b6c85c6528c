# SPDX-License-Identifier: Apache-2.0
"""Systematic contributions as shared parameters: what each is, and its standard uncertainty.

Each is an effect of the catalogue with the same coefficients in the whole calibration; the
columns are those of the effect (``Effect.terms``).

Air: the refractivity n - 1 = 2.72e-4 (20 degC, 1013.25 hPa) is proportional to the density of
air, so its relative change is 1 / 293.15 per K and 1 / 101325 per Pa: 0.93e-6 and 2.7e-9 of the
length (Ciddor, Applied Optics 35 (1996) 1566; Edlen's equation as modified by Birch and Downs,
Metrologia 31 (1994) 315, gives the same).

Angles of the tracker: makers specify the error across the beam as a + b R. The parameters of the
family each take an equal share of it in mean square over the pieces: the offsets of a, the
angles of b R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.effects import REGISTRY, Shape, State, Terms
from otf_core.model.declared import DeclaredUncertainty
from otf_core.model.tables import ErrorTables
from otf_core.pieces.observed import Observed
from otf_core.solving.columns import across, piece_state, sensitivity
from otf_core.solving.joint import JointSolution

Array = NDArray[np.float64]

PER_KELVIN = 0.93e-6
PER_PASCAL = 2.7e-9
"""Relative change of a length measured in air, per K and per Pa."""
NO_EFFECT = 1e-9
"""Displacement per unit of a parameter, relative to the largest possible, that is rounding."""
AT_ONCE = 1e-6
"""s; time constant of a warming that is complete when the run starts."""


@dataclass(frozen=True)
class Systematic:
    """One contribution.

    Attributes
    ----------
    source : str
        As the budget calls it.
    effect : str
        Name in the catalogue.
    keys : tuple of str
        Keys of machine.yaml, any of which declares it.
    shape : mapping
        Shape of the effect.
    """

    source: str
    effect: str
    keys: tuple[str, ...]
    shape: Shape

    def uncertainty(self, terms: Terms, state: State, declared: DeclaredUncertainty) -> Array:
        """Standard uncertainty of every coefficient, shape (k,)."""
        given = declared.get(*self.keys)
        if self.effect == 'tracker_angles':
            return _shared_equally(terms, state, *given)
        if self.source == 'air':
            level = float(np.hypot(given[0] * PER_KELVIN, given[1] * PER_PASCAL))
        else:
            level = float(np.prod(given))
        return np.full(len(terms.names), level)


SYSTEMATIC = (
    Systematic('tracker scale', 'tracker_scale', ('tracker_scale',), {}),
    Systematic('air', 'tracker_scale', ('air_temperature', 'air_pressure'), {}),
    Systematic('tracker range offset', 'tracker_range_offset', ('tracker_range_offset',), {}),
    Systematic('tracker angles', 'tracker_angles', ('tracker_offset', 'tracker_angle'), {}),
    Systematic(
        'machine temperature',
        'thermal_axis_expansion',
        ('machine_temperature', 'expansion'),
        {'tau': AT_ONCE, 'until': 0.0, 'order': 1.0},
    ),
    Systematic('target offset', 'target_offset', ('target_offset',), {}),
)


def _shared_equally(terms: Terms, state: State, offset: float, angle: float) -> Array:
    distance = np.linalg.norm(state.beam, axis=1)
    beam = state.beam / distance[:, None]
    along = np.einsum('ij,ijk->ik', beam, terms.columns)
    beside = terms.columns - beam[:, :, None] * along[:, None, :]
    size = np.sqrt(np.mean(np.sum(beside**2, axis=1), axis=0))
    is_offset = np.array([unit == 'm' for unit in terms.units])
    wanted = np.where(is_offset, offset, angle * np.sqrt(np.mean(distance**2)))
    # what displaces nothing on this path, but for rounding, has no share
    acts = size > NO_EFFECT * np.where(is_offset, 1.0, np.sqrt(np.mean(distance**2)))
    share = np.where(is_offset, (acts & is_offset).sum(), (acts & ~is_offset).sum())
    size, share = np.where(acts, size, np.inf), np.maximum(share, 1)
    # in each of the two directions across the beam: hence the factor 2
    return np.asarray(wanted * np.sqrt(2.0 / share) / size)


def declared_sources(runs: Sequence[Observed]) -> tuple[Systematic, ...]:
    """Contributions that any run declares."""
    given = {k for r in runs if r.machine.uncertainty for k in r.machine.uncertainty.values}
    return tuple(s for s in SYSTEMATIC if given & set(s.keys))


def systematic_sensitivity(
    source: Systematic, runs: Sequence[Observed], done: JointSolution, tables: ErrorTables
) -> Array:
    """Change of the estimates per standard uncertainty of each coefficient, shape (full, k).

    A coefficient is one parameter shared by all runs.
    """
    effect, columns = REGISTRY[source.effect], []
    for run, solved in zip(runs, done.runs, strict=True):
        state = piece_state(run, solved, done.unknowns.knots, tables)
        terms = effect.terms(state, source.shape)
        declared = run.machine.uncertainty or DeclaredUncertainty({})
        u = source.uncertainty(terms, state, declared)
        columns.append(across(solved, terms.columns * u))
    return sensitivity(done, columns)

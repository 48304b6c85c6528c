# SPDX-License-Identifier: Apache-2.0
"""Reversal of the error motions: how they differ between forward and backward travel.

Unknowns are the coefficients of the effects ``backlash`` (constants of EXX, EYY, EZZ) and
``direction_dependent_tables`` (all others), with their formulas:

    delta = 1/2 sign(d_a) sum_k c_k P_k(u_a) J_m(q)      motion m of axis a

The reversal value of a motion is its error in forward travel less that in backward travel
(ISO 230-2: difference of the means of the two directions of approach); tables hold the mean.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.catalogue.direction_dependent_tables import ORDER, functions_along
from otf_core.model.chain import Sight
from otf_core.model.expanded import quantity
from otf_core.model.machine import Axis
from otf_core.model.motions import DIRECTIONS
from otf_core.model.tables import ErrorTables
from otf_core.solving.unknowns import Unknowns, reversal_blocks

NONE, CONSTANT, TABLES, AUTO = 'none', 'constant', 'tables', 'auto'
MODELS = {NONE: 0, CONSTANT: 1, TABLES: ORDER + 1}
"""Polynomials per motion in every model, the simplest first."""


def count_functions(axis: Axis, model: str) -> int:
    """Functions per motion of an axis; one more where it turns: worms and gears make waves."""
    return MODELS[model] + (model == TABLES and axis.rotary)


@dataclass(frozen=True)
class ReversalTable:
    """Reversal value of one motion along its axis.

    Attributes
    ----------
    position : ndarray, shape (k,), m
        Nodes of the table of the motion.
    value, u : ndarray, shape (k,), m or rad
        Forward minus backward, and its standard uncertainty (k = 1).
    identifiable : bool
        False if the data cannot see it; its values are zero then.
    """

    position: Array
    value: Array
    u: Array
    identifiable: bool


@dataclass(frozen=True)
class Backlash:
    """Reversal value of an axis at the target: along it, all its motions that reverse together.

    Attributes
    ----------
    value, u : float, m
        Forward minus backward, mean along the middle line of the axis; standard uncertainty.
    """

    value: float
    u: float

    @property
    def words(self) -> str:
        """Value and expanded uncertainty (k = 2)."""
        return quantity(self.value, self.u, 'm')


@dataclass(frozen=True)
class Reversal:
    """Reversal model of a calibration.

    Attributes
    ----------
    model : str
        A name of ``MODELS``.
    evidence : mapping of str to number or text
        Why this model: see ``model_choice.choose``.
    motions : mapping of motion name to ReversalTable
        Empty for the model 'none'.
    held : bool
        Axes that stand stay on the side of their last travel.
    backlash : mapping of axis to Backlash
        Of the axes whose positioning the data see; empty for the model 'none'.
    """

    model: str
    evidence: Mapping[str, float | int | str]
    motions: Mapping[str, ReversalTable]
    held: bool = False
    backlash: Mapping[str, Backlash] = field(default_factory=dict)

    @property
    def not_identifiable(self) -> tuple[str, ...]:
        """Motions whose reversal the data cannot see."""
        return tuple(n for n, table in self.motions.items() if not table.identifiable)


def reversal_tables(
    tables: ErrorTables,
    unknowns: Unknowns,
    estimate: Array,
    covariance: Array,
    accepted: Collection[str],
) -> dict[str, ReversalTable]:
    """Reversal values at the table nodes.

    Parameters
    ----------
    tables : ErrorTables
        With the nodes.
    estimate, covariance : ndarray, shape (full,) and (full, full), m and rad
    accepted : collection of str
        Blocks that were solved for.

    Returns
    -------
    mapping of motion to ReversalTable
        Of the motions whose reversal is among the unknowns.
    """
    tables_by_motion: dict[str, ReversalTable] = {}
    for motion in tables.machine.motions:
        names = reversal_blocks(unknowns, motion)
        if not names:
            continue
        nodes = tables.motions[motion].position
        index = [unknowns.blocks[n].start for n in names]
        along = functions_along(tables.machine.axes[motion.axis], nodes, len(names) - 1)
        variance = np.einsum('ij,jk,ik->i', along, covariance[np.ix_(index, index)], along)
        tables_by_motion[motion] = ReversalTable(
            nodes,
            along @ estimate[index] + 0.0,
            np.sqrt(np.maximum(variance, 0.0)),
            any(n in accepted for n in names),
        )
    return tables_by_motion


def backlash_at_target(
    tables: ErrorTables,
    unknowns: Unknowns,
    estimate: Array,
    covariance: Array,
    accepted: Collection[str],
) -> dict[str, Backlash]:
    """Reversal value of every axis at the target, on its line through the middle of the volume.

    A rotation that reverses displaces the target as positioning does, and the two are hardly told
    apart, so that their sum is known far better than the positioning at the reference point.

    Parameters
    ----------
    tables, unknowns, estimate, covariance, accepted
        See ``reversal_tables``.
    """
    machine, backlash = tables.machine, {}
    middle = 0.5 * (machine.lower + machine.upper)
    for column, name in enumerate(machine.axis_names):
        positioning = reversal_blocks(unknowns, f'E{name}{name}')
        if machine.axes[name].rotary or not positioning or positioning[0] not in accepted:
            continue
        nodes = tables.motions[f'E{name}{name}'].position
        q = np.tile(middle, (len(nodes), 1))
        q[:, column] = nodes
        seen = Sight.of_tool(machine).at(q)
        moved = np.einsum('ni,nik->nk', seen.velocity[:, :, column], seen.motions[name])
        row = np.zeros(len(estimate))
        for d, letter in enumerate(DIRECTIONS):
            blocks = reversal_blocks(unknowns, f'E{letter}{name}')
            along = functions_along(machine.axes[name], nodes, max(len(blocks) - 1, 0))
            for block, weight in zip(blocks, along.T, strict=False):
                if block in accepted:
                    row[unknowns.blocks[block].start] += float(np.mean(moved[:, d] * weight))
        u = float(np.sqrt(max(0.0, float(row @ covariance @ row))))
        backlash[name] = Backlash(float(row @ estimate), u)
    return backlash

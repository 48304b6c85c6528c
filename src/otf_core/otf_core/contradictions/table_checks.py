# SPDX-License-Identifier: Apache-2.0
"""Tables too fine for the pieces of the path, and tables as uncertain as the errors they state."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.machine import Machine
from otf_core.model.nodes import axis_nodes
from otf_core.model.tables import ErrorTables
from otf_core.pieces.finding import GATE, WARNING, Finding
from otf_core.pieces.runs import Observed
from otf_core.prediction.volumetric import VolumetricError

_log = logging.getLogger(__name__)

MAX_UNKNOWNS = 6000
"""Values of all nodes; solving for more takes gigabytes and hours."""


def check_table_pitch(machine: Machine, piece_length: float) -> str:
    """Look at the spacing of the nodes before anything is solved.

    Parameters
    ----------
    piece_length : float
        m; what the samples of a line are averaged over.

    Returns
    -------
    str
        Words on axes with nodes closer than that; empty if there are none. Logged as well: the
        solution takes long then.

    Raises
    ------
    ConfigError
        If there are so many nodes that no solution would end.
    """
    nodes = {name: len(axis_nodes(axis)) for name, axis in machine.axes.items()}
    values = 6 * sum(nodes.values())
    fine = [name for name, axis in machine.axes.items() if axis.table_pitch < piece_length]
    named = ', '.join(
        f'{name} {1e3 * machine.axes[name].table_pitch:g} mm ({nodes[name]} nodes)'
        for name in fine or nodes
    )
    if values > MAX_UNKNOWNS:
        wide = max(6 * sum(a.max - a.min for a in machine.axes.values()) / MAX_UNKNOWNS, 1e-3)
        raise ConfigError(
            f'axes: table_pitch: {named} give {values} unknowns, but at most {MAX_UNKNOWNS} can '
            f'be '
            f'solved for: use a table_pitch of {1e3 * wide:.2g} mm or more on all axes, or is it '
            f'in another unit?'
        )
    if not fine:
        return ''
    words = (
        f'table_pitch: {named}: finer than the {1e3 * piece_length:g} mm that a piece of the path '
        f'averages over: the data cannot distinguish neighbouring nodes, and solving takes '
        f'longer; take at least {1e3 * piece_length:g} mm'
    )
    _log.warning(words)
    return words


MAX_U_OF_GOOD_MACHINE = 5.0
"""Uncertainty over the noise of a sample below which small errors mean a good machine."""


def sample_noise(runs: Sequence[Observed]) -> float:
    """Largest standard deviation of single samples among runs, m."""
    levels = []
    for run in runs:
        distance = np.linalg.norm(run.pieces.xyz, axis=1)
        level = run.noise.level
        levels.append(float(np.hypot(level[0], level[1:].max() * distance.max())))
    return max(levels)


def check_worth(tables: ErrorTables, covariance: Array, noise: float) -> list[Finding]:
    """Compare the error that tables state with its uncertainty.

    Parameters
    ----------
    covariance : ndarray, shape (m, m)
    noise : float
        m; of a sample.
    """
    volume = VolumetricError(tables, covariance)
    error = float(np.sqrt(np.mean(volume.length**2)))
    u = float(np.sqrt(np.median(volume.u_size**2)))
    if u < error:
        return []
    text = (
        f'the volumetric error by the tables is {1e6 * error:.2f} um, and its standard '
        f'uncertainty exceeds {1e6 * u:.2f} um in half of the driven volume'
    )
    if u < MAX_U_OF_GOOD_MACHINE * noise:
        return [Finding('worth', WARNING, (
            f'{text}: no larger than the tracker can resolve; the machine needs no tables, '
            f'or the tracker a better position'
        ))]  # fmt: skip
    return [Finding('worth', GATE, (
        f'{text}: they would not improve the machine. The path determines too little, or the '
        f'residuals are far above the noise: drive a path that plan recommends, use a '
        f'larger table_pitch, and note the warnings'
    ))]  # fmt: skip

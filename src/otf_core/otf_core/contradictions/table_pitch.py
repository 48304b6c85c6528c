# SPDX-License-Identifier: Apache-2.0
"""A table pitch so fine that the pieces of the path say nothing of every node, or nothing ends."""

from __future__ import annotations

import logging

from otf_core.errors import ConfigError
from otf_core.model.machine import Machine
from otf_core.model.nodes import axis_nodes

_log = logging.getLogger(__name__)

MOST_UNKNOWNS = 6000
"""Values of all nodes; solving for more takes gigabytes and hours."""


def check_table_pitch(machine: Machine, piece_length: float) -> str:
    """Look at the spacing of the nodes before anything is solved.

    Parameters
    ----------
    machine : Machine
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
    if values > MOST_UNKNOWNS:
        wide = max(6 * sum(a.max - a.min for a in machine.axes.values()) / MOST_UNKNOWNS, 1e-3)
        raise ConfigError(
            f'axes: table_pitch: {named} make {values} unknowns, more than the {MOST_UNKNOWNS} '
            f'that can be solved for; a table_pitch of {1e3 * wide:.2g} mm or more on all axes '
            f'can; is it meant in another unit?'
        )
    if not fine:
        return ''
    words = (
        f'table_pitch: {named}: finer than the {1e3 * piece_length:g} mm that a piece of the path '
        f'averages over: neighbouring nodes are not told apart by the data, and solving takes '
        f'longer; take at least {1e3 * piece_length:g} mm'
    )
    _log.warning(words)
    return words

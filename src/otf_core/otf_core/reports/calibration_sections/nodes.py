# SPDX-License-Identifier: Apache-2.0
"""Every node of every table."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.files.csv_points import tidy
from otf_core.model.motions import MOTIONS, ErrorMotion
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.quantities import dof_words, micro, micro_unit
from otf_core.reports.section import Section, Table

FEW = 100
"""Samples around a node below which they are called few."""


def section(facts: Facts) -> Section:
    """Return the section."""
    counts = {axis: node_counts(facts, axis) for axis in facts.machine.axis_names}
    tables = tuple(_table(facts, name, counts[name.axis]) for name in MOTIONS)
    words = (
        'Position in mm, value, u (k = 1) and U (95 %) in um or urad, as in error_tables.csv '
        '(there in m and rad). n_obs: samples nearer to this node than to its neighbours.',
    )
    return Section('nodes', 'All nodes', words, {}, tables)


def node_counts(facts: Facts, axis: str) -> NDArray[np.int64]:
    """Samples used around every node of an axis, shape (k,)."""
    position = facts.tables.motions[f'E{axis}{axis}'].position
    edges = np.concatenate([[-np.inf], 0.5 * (position[1:] + position[:-1]), [np.inf]])
    k = facts.machine.axis_names.index(axis)
    q = np.concatenate([run.q[:, k] for run in facts.result.runs])
    count = np.concatenate([run.pieces.count for run in facts.result.runs])
    found = np.histogram(q, edges, weights=count)[0]
    return np.asarray(found, dtype=np.int64)


def _flag(seen: bool, identifiable: bool, count: int) -> str:
    if not identifiable:
        return 'unobservable'
    if not seen:
        return 'not determined, continued'
    return 'few data' if count < FEW else 'ok'


def _table(facts: Facts, name: ErrorMotion, counts: NDArray[np.int64]) -> Table:
    table, line = facts.tables.motions[name], facts.by_name.get(name)
    k = line.k if line else 0.0
    coverage = (f'{k:.2f}', dof_words(line.dof)) if line else ('-', '-')
    known = table.node_identifiable
    flags = np.ones(len(table.position), dtype=bool) if known is None else known
    rows = tuple(
        (
            f'{tidy(1e3 * float(x)):.6g}',
            micro(float(v), 3),
            micro(float(u), 3),
            micro(k * float(u), 3),
            *coverage,
            str(int(n)),
            _flag(bool(seen), table.identifiable, int(n)),
        )
        for x, v, u, n, seen in zip(
            table.position, table.value, table.u, counts, flags, strict=True
        )
    )
    head = ('Position (mm)', 'Value', 'u (k = 1)', 'U', 'k', 'v_eff', 'n_obs', 'Flag')
    return Table(head, rows, numbers=tuple(range(7)), folded=f'{name} ({micro_unit(name.unit)})')

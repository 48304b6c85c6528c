# SPDX-License-Identifier: Apache-2.0
"""True errors of a simulated machine (layout of error_tables.json) in the volume and as tables."""

import numpy as np
from certified.exact_chain import AXES, MOTIONS, SQUARENESS, influences, target_on_table
from certified.measured_rows import pose_columns


def lattice(low, high, count):
    """Regular points (count^3, 3) between two corners."""
    axes = [np.linspace(a, b, count) for a, b in zip(low, high, strict=True)]
    return np.stack([g.ravel() for g in np.meshgrid(*axes, indexing='ij')], axis=1)


def errors_at(tables, q):
    """Values of MOTIONS and SQUARENESS of tables (plain data) at q (n, 3), shape (n, 21)."""
    motions = [tables['motions'][m] for m in MOTIONS]
    found = [np.interp(q[:, AXES.index(m['axis'])], m['position'], m['value']) for m in motions]
    tilts = [np.full(len(q), tables['squareness'][s]['value']) for s in SQUARENESS]
    return np.stack([*found, *tilts], axis=1)


def first_order(tables, q):
    """Error vectors (n, 3) of tables at q (n, 3), m."""
    machine = tables['machine']
    columns = influences(machine['chain'], np.array(machine['target_offset']), q)
    return np.einsum('nik,nk->ni', columns, errors_at(tables, q))


def exact(tables, q):
    """The same by rotation matrices along the chain."""
    machine = tables['machine']
    offset = np.array(machine['target_offset'])
    return target_on_table(machine['chain'], offset, q, errors_at(tables, q)) - q


def without_rigid_motion(values, q):
    """Vectors, or rows of vectors, (n, 3, ...) less the small rigid motion nearest to them."""
    basis = np.linalg.qr(pose_columns(q).reshape(-1, 6))[0]
    flat = values.reshape(len(basis), -1)
    return (flat - basis @ (basis.T @ flat)).reshape(values.shape)


def mean_length(vectors):
    """Mean length of vectors (n, 3)."""
    return np.linalg.norm(vectors, axis=1).mean()


def in_gauge(model, tables, q):
    """Free values of a model whose errors at q (n, 3) are nearest to those of tables."""
    rows = model.error_rows(q)
    rows[:, :, :6] = pose_columns(q)
    wanted = first_order(tables, q)
    return np.linalg.lstsq(rows.reshape(-1, rows.shape[2]), wanted.ravel(), rcond=None)[0]

# SPDX-License-Identifier: Apache-2.0
"""Work of ``alternatives.py`` in processes of its own: make a case, or get from its bag to tables.

A case is a folder with bag, machine.yaml and the true error on a grid (truth.npz). The solvers
share the read with rosbags, ``simple_pieces`` and the unknowns of Eq. 7; all rows count alike.
The pose of the stops is within micrometres, so the linear ones need one linearisation only.

Prints JSON: seconds from bag to tables after the imports, processor seconds of the same, the
peak of the process until then in bytes, mean error on the grid before and after in um, unknowns
and rows. The best rigid motion is taken out of the errors.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import yaml
from child import KIB
from linear_estimators import LETTERS, NAMES, Geometry, geometry, influences, table_bases
from linear_estimators import columns as dense_columns
from nature import SQUARE, Cell
from scipy import sparse
from scipy.optimize import least_squares
from scipy.sparse.linalg import lsqr
from scipy.spatial.transform import Rotation
from simple_pieces import Run, reduce_run
from with_rosbags import read_with_rosbags

import otf_core

MACHINE = Path(__file__).resolve().parents[1] / 'src/otf_bringup/config/machine.yaml'
TOLERANCE = 1e-10
UM = 1e6


def make(folder: Path, kind: str, seed: int) -> dict:
    """Simulate a run: 'simulate' of the project, or a form of error motions of ``nature``."""
    folder.mkdir(parents=True)
    if kind == 'simulate':
        machine = otf_core.load_machine(MACHINE)
        run = otf_core.simulate(machine, seed=seed, config=otf_core.SimulationConfig(rate=250.0))
        ends = [np.linspace(a, b, 7) for a, b in zip(machine.lower, machine.upper, strict=True)]
        q = np.stack(np.meshgrid(*ends, indexing='ij'), axis=-1).reshape(-1, 3)
        recording, error = run.recording, otf_core.predict(run.truth, q).error
        text = MACHINE.read_text(encoding='utf-8')
    else:
        cell = Cell(seed, form=kind)
        recording, q = cell.recording(rate=200.0), cell.lattice()
        error, text = cell.error(q), yaml.safe_dump(machine_of(cell))
    (folder / 'machine.yaml').write_text(text, encoding='utf-8')
    np.savez(folder / 'truth.npz', q=q, error=error)
    otf_core.write_bag(recording, folder / 'bag')
    return {'samples': len(recording.samples)}


def machine_of(cell) -> dict:
    """Content of machine.yaml of a cell."""
    axes, spec = cell.machine.axes, cell.machine.tracker
    return {
        'name': 'cell',
        'chain': cell.chain,
        'axes': {a: {'min': axes[a].min, 'max': axes[a].max, 'table_pitch': axes[a].table_pitch}
                 for a in LETTERS},
        'target_offset': cell.offset.tolist(),
        'tracker': {'u_range': spec.u_range, 'u_angle': spec.u_angle},
    }  # fmt: skip


def cell_of(folder: Path) -> SimpleNamespace:
    """What a machine.yaml says, as ``linear_estimators`` takes it."""
    machine = otf_core.load_machine(folder / 'machine.yaml')
    chain = yaml.safe_load((folder / 'machine.yaml').read_text(encoding='utf-8'))['chain']
    return SimpleNamespace(machine=machine, chain=chain, offset=np.array(machine.target_offset))


@dataclass(frozen=True)
class Problem:
    """Pieces of a run in the pose of its stops, and their sparse rows (2 p, 9 + m)."""

    cell: SimpleNamespace
    bases: dict
    run: Run
    place: Geometry
    rows: sparse.csr_matrix


def problem(folder: Path):
    """Read with rosbags, reduce to pieces, write the rows of Eq. 7: a ``Problem``."""
    cell = cell_of(folder)
    bases = table_bases(cell)
    nodes = [bases[f'EX{axis}'].nodes for axis in LETTERS]
    run = reduce_run(*read_with_rosbags(folder / 'bag'), nodes)
    pose, still = run.T_machine_tracker, np.zeros((len(run.pieces.leg), 3))
    place = geometry(run.pieces, pose.rotation, pose.translation, still)
    return Problem(cell, bases, run, place, whole_rows(cell, bases, place))


def model_rows(cell, bases, q, direction):
    """Displacement along directions (n, 3) per squareness and coefficient, sparse (n, 3 + m)."""
    shares = {n: np.einsum('ij,ij->i', v, direction)
              for n, v in influences(cell.chain, cell.offset, q).items()}  # fmt: skip
    parts = [sparse.csr_matrix(np.stack([shares[n] for n in SQUARE], axis=1))]
    row = np.arange(len(q))
    for name in NAMES:
        nodes, at = bases[name].nodes, q[:, LETTERS.index(name[2])]
        low = np.clip(np.searchsorted(nodes, at, side='right') - 1, 0, len(nodes) - 2)
        part = np.clip((at - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)
        weights = np.concatenate([(1 - part) * shares[name], part * shares[name]])
        places = (np.tile(row, 2), np.concatenate([low, low + 1]))
        block = sparse.csc_matrix((weights, places), shape=(len(q), len(nodes)))
        parts.append(block[:, bases[name].root.any(axis=1)])
    return sparse.hstack(parts, format='csr')


def whole_rows(cell, bases, place):
    """Rows of ``linear_estimators.design``, sparse."""
    stacked = []
    for axes in place.axes:
        pose = -np.concatenate([axes, np.cross(place.points, axes)], axis=1)
        model = model_rows(cell, bases, place.q, axes)
        stacked.append(sparse.hstack([sparse.csr_matrix(pose), model]))
    return sparse.vstack(stacked, format='csr')


def by_pinv(given: Problem):
    """Dense pseudo-inverse, as in Eq. 7 of the paper; columns scaled to unit length."""
    rows = given.rows.toarray()
    scale = 1.0 / np.linalg.norm(rows, axis=0)
    return scale * (np.linalg.pinv(rows * scale) @ given.place.observed)


def by_lsqr(given: Problem):
    """SciPy's sparse least squares on the same rows; columns scaled to unit length."""
    scale = 1.0 / sparse.linalg.norm(given.rows, axis=0)
    found = lsqr(
        given.rows @ sparse.diags(scale),
        given.place.observed,
        atol=TOLERANCE,
        btol=TOLERANCE,
        iter_lim=100_000,
    )
    return scale * found[0]


def by_least_squares(given: Problem):
    """SciPy's general solver: sparsity of the Jacobian is known, its values by differences."""
    found = least_squares(
        partial(residuals, given),
        np.zeros(given.rows.shape[1]),
        jac_sparsity=given.rows != 0,
        x_scale='jac',
        ftol=TOLERANCE,
        xtol=TOLERANCE,
        gtol=None,
    )
    return found.x


def residuals(given: Problem, x):
    """Across the path in um, (2 p,), not linearised; x: shift, turn, squareness, coefficients."""
    pieces, cell, pose = given.run.pieces, given.cell, given.run.T_machine_tracker
    turn = Rotation.from_rotvec(x[3:6]).as_matrix()
    points = (pieces.xyz @ pose.rotation.T + pose.translation) @ turn.T + x[:3]
    along = np.einsum('ij,ij->i', points - pieces.origin, pieces.direction)
    q = pieces.origin + along[:, None] * pieces.direction
    influence, rest, at = influences(cell.chain, cell.offset, q), points - q, 9
    for name, value in zip(SQUARE, x[6:9], strict=True):
        rest -= value * influence[name]
    for name in NAMES:
        basis = given.bases[name]
        curve = basis.root @ x[at : at + basis.root.shape[1]]
        at += basis.root.shape[1]
        value = np.interp(q[:, LETTERS.index(name[2])], basis.nodes, curve)
        rest -= influence[name] * value[:, None]
    return UM * np.einsum('kij,ij->ki', given.place.axes, rest).ravel()


def by_ceres(given: Problem):
    """Ceres through its Python wheel: one residual block per leg, one parameter block per motion.

    The derivatives are those at the start: the residuals are nearly linear.
    """
    import pyceres  # no dependency of the project

    sizes = [9, *(given.bases[name].root.shape[1] for name in NAMES)]
    sizes = [size for size in sizes if size]
    values = [np.zeros(size) for size in sizes]
    cuts = np.cumsum(sizes)[:-1]

    class OneLeg(pyceres.CostFunction):
        def __init__(self, part: Problem) -> None:
            super().__init__()
            self.part = part
            derivatives = np.split(-UM * part.rows.toarray(), cuts, axis=1)
            self.derivatives = [own.ravel() for own in derivatives]
            self.set_num_residuals(part.rows.shape[0])
            self.set_parameter_block_sizes(sizes)

        def Evaluate(self, parameters, out, jacobians):
            out[:] = residuals(self.part, np.concatenate(parameters))
            if jacobians is not None:
                for wanted, own in zip(jacobians, self.derivatives, strict=True):
                    if wanted is not None:
                        wanted[:] = own
            return True

    task, options, summary = pyceres.Problem(), pyceres.SolverOptions(), pyceres.SolverSummary()
    legs = [OneLeg(of_leg(given, leg)) for leg in np.unique(given.run.pieces.leg)]
    for leg in legs:
        task.add_residual_block(leg, None, values)
    options.linear_solver_type = pyceres.LinearSolverType.SPARSE_NORMAL_CHOLESKY
    options.function_tolerance = options.parameter_tolerance = TOLERANCE
    options.logging_type = pyceres.LoggingType.SILENT
    pyceres.solve(options, task, summary)
    if not summary.IsSolutionUsable():
        raise SystemExit(summary.BriefReport())
    return np.concatenate(values)


def of_leg(given: Problem, leg: int) -> Problem:
    """Only what one leg has to say."""
    use = np.flatnonzero(given.run.pieces.leg == leg)
    pieces = given.run.pieces
    own = {part.name: getattr(pieces, part.name)[use] for part in fields(pieces)}
    rows = given.rows[np.concatenate([use, use + len(pieces.leg)])]
    return replace(
        given,
        run=replace(given.run, pieces=replace(pieces, **own)),
        place=replace(given.place, axes=given.place.axes[:, use]),
        rows=rows,
    )


def by_otf(folder: Path):
    """``otf_core``: read and calibrate."""
    machine = otf_core.load_machine(folder / 'machine.yaml')
    return otf_core.calibrate(otf_core.read_bag(folder / 'bag', machine))


def solve(folder: Path, kind: str) -> dict:
    """Run one of them and judge what is left."""
    with np.load(folder / 'truth.npz') as truth:
        q, error = truth['q'], truth['error']
    start, processor = time.perf_counter(), time.process_time()
    if kind == 'otf':
        found = by_otf(folder)
    else:
        given = problem(folder)
        value = KINDS[kind](given)[6:]
    wall, processor = time.perf_counter() - start, time.process_time() - processor
    peak = KIB * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if kind == 'otf':
        field = otf_core.predict(found, q).error
        rows, unknowns = 2 * found.fit.pieces, found.fit.unknowns
    else:
        field = dense_columns(given.cell, given.bases, q) @ value
        rows, unknowns = given.rows.shape
    before, left = (np.linalg.norm(otf_core.without_rigid_motion(f, q), axis=1).mean()
                    for f in (error, field - error))  # fmt: skip
    return {'wall': wall, 'processor': processor, 'peak': peak, 'before': UM * before,
            'left': UM * left, 'rows': rows, 'unknowns': unknowns}  # fmt: skip


KINDS = {
    'pinv': by_pinv,
    'lsqr': by_lsqr,
    'least_squares': by_least_squares,
    'ceres': by_ceres,
}
"""All but the project's own, 'otf'."""

if __name__ == '__main__':
    job, where, *words = sys.argv[1:]
    if job == 'make':
        print(json.dumps(make(Path(where), words[0], int(words[1]))))
    else:
        print(json.dumps(solve(Path(where), job)))

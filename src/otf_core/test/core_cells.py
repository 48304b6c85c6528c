# SPDX-License-Identifier: Apache-2.0
"""Small cells for the tests of the core: machines, drives, and ways to spoil a recording."""

import json
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from nature import SQUARE, table_rows, target_on_table
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from otf_core.config import PlannerConfig
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import AXES, Axis, Chain, Machine, TrackerSpec
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.nodes import table_nodes
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath, sides_of_travel
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.noise.noise_model import NoiseModel, covariance_parts
from otf_core.pieces.pieces import Pieces
from otf_core.pieces.runs import Observed
from otf_core.planning.nc.programs import on_increment, part_program
from otf_core.planning.path_creation import plan_path
from otf_core.prediction.calibration_document import tables_to_dict
from otf_core.sim.drive import drives_of
from otf_core.solving.normal import NormalEquations, normal_equations
from otf_core.solving.solution import TIE_BREAK, Solution, identifiable_blocks, smoothness, solve
from otf_core.solving.system import System, build_system
from otf_core.solving.unknowns import Unknowns, layout, linear_bases
from otf_core.solving.whitener import Whitener

CONTRACT_CHAINS = ('w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t')
RANGES = ((0.0, 0.3), (0.0, 0.25), (-0.2, 0.0))
START_NS = 1_700_000_000_000_000_000


def some_machine(chain='w-b-X-Y-Z-t', ranges=RANGES, pitch=0.05, offset=(0.02, -0.03, -0.15)):
    axes = {a: Axis(low, high, pitch) for a, (low, high) in zip(AXES, ranges, strict=True)}
    spec = TrackerSpec(0.5e-6, 2e-6)
    return Machine('small', Chain.parse(chain), axes, np.array(offset), spec)


def observed(machine, pieces, pose):
    """Pieces seen by the tracker that the machine states."""
    noise = NoiseModel.from_spec(machine.tracker)
    return Observed(machine=machine, pieces=pieces, pose=pose, noise=noise)


def written_tables(tmp_path, tables, **blocks):
    """An error_tables.json with further blocks."""
    file = tmp_path / 'error_tables.json'
    file.write_text(json.dumps({**tables_to_dict(tables), **blocks}))
    return file


def zero_tables(machine, nodes=2):
    """Tables without any error, ``nodes`` nodes each."""
    motions = {}
    for name in MOTIONS:
        axis = machine.axes[name[2]]
        position = np.linspace(axis.min, axis.max, nodes)
        motions[name] = MotionTable(position, np.zeros(nodes), np.zeros(nodes))
    return ErrorTables(machine, motions, {k: ScalarError() for k in SQUARENESS})


def constant_tables(machine, **errors):
    """Tables with the named errors constant over the range, all others zero."""
    tables = zero_tables(machine)
    motions, squareness = dict(tables.motions), dict(tables.squareness)
    for name, value in errors.items():
        if name in SQUARENESS:
            squareness[name] = ScalarError(value)
        else:
            motions[name] = replace(motions[name], value=np.full(2, value))
    return replace(tables, motions=motions, squareness=squareness)


def error_of(tables, q):
    """First-order errors (n, 3), m, by the formula of the tests, not by that of the solver."""
    machine = tables.machine
    rows, values = table_rows(tables, str(machine.chain), machine.target_offset, q)
    return rows @ values


def position_of(tables, q):
    """Exact positions (n, 3), m, of a machine with these errors: products of 4x4 transforms."""
    machine = tables.machine
    curves = {name: table.at for name, table in tables.motions.items()}
    square = {name: tables.squareness[name].value for name in SQUARE}
    return target_on_table(str(machine.chain), machine.target_offset, curves, square, q)


def smooth(tables, nodes=121):
    """Tables of cubic splines through the nodes, fine enough to pass for smooth curves."""
    motions = {}
    for name, table in tables.motions.items():
        position = np.linspace(table.position[0], table.position[-1], nodes)
        value = CubicSpline(table.position, table.value)(position)
        motions[name] = MotionTable(position, value, np.zeros(nodes))
    return replace(tables, motions=motions)


@dataclass
class Recording:
    """Programmed positions over time; each method returns a changed copy."""

    machine: Machine
    path: NominalPath
    time: np.ndarray
    q: np.ndarray

    def cut(self, *spans):
        """Leave out the samples between pairs of times, s."""
        keep = np.ones(len(self.time), bool)
        for low, high in spans:
            keep &= ~((self.time >= low) & (self.time < high))
        return replace(self, time=self.time[keep], q=self.q[keep])

    def between(self, low, high):
        """Keep the samples between two times, s."""
        keep = (self.time >= low) & (self.time < high)
        return replace(self, time=self.time[keep], q=self.q[keep])

    def paused(self, at, seconds):
        """Stop in no time at a moment, stand still, and go on."""
        k = int(np.searchsorted(self.time, at))
        step = self.time[1] - self.time[0]
        extra = round(seconds / step)
        still = self.time[k] + step * np.arange(1, extra + 1)
        time = np.concatenate([self.time[: k + 1], still, self.time[k + 1 :] + extra * step])
        q = np.concatenate([self.q[: k + 1], np.tile(self.q[k], (extra, 1)), self.q[k + 1 :]])
        return replace(self, time=time, q=q)

    def with_moves(self, before=(), after=(), speed=0.2):
        """Drive through further points before the start and after the end."""
        step = self.time[1] - self.time[0]

        def drive(points):
            rows = [np.empty((0, 3))]
            for a, b in pairwise(points):
                count = max(2, int(np.linalg.norm(b - a) / speed / step))
                rows.append(a + np.linspace(0, 1, count, endpoint=False)[:, None] * (b - a))
            return np.concatenate(rows)

        head = drive([*map(np.asarray, before), self.q[0]])
        tail = drive([self.q[-1], *map(np.asarray, after)])
        q = np.concatenate([head, self.q, tail])
        lead = self.time[0] + step * np.arange(-len(head), 0)
        trail = self.time[-1] + step * np.arange(1, len(tail) + 1)
        return replace(self, time=np.concatenate([lead, self.time, trail]), q=q)

    def measured(self, tables=None, seed=0, pose=None, noise=1.0, exact=True):
        """Samples of this recording; white noise, random pose of the tracker if none is given."""
        rng = np.random.default_rng(seed)
        tables = tables or zero_tables(self.machine)
        actual = position_of(tables, self.q) if exact else self.q + error_of(tables, self.q)
        rotation, place = pose or some_pose(self.machine, rng)
        xyz = (actual - place) @ rotation.T
        xyz = xyz + noise * tracker_noise(xyz, self.machine.tracker, rng)
        return Samples(START_NS + np.rint(self.time * 1e9).astype(np.int64), xyz)


def some_pose(machine, rng):
    """Random orientation of a tracker beside the working volume."""
    centre = 0.5 * (machine.lower + machine.upper)
    side = rng.uniform(0, 2 * np.pi)
    reach = 0.5 * np.linalg.norm(machine.upper - machine.lower) + rng.uniform(0.2, 0.4)
    place = centre + reach * np.array([np.cos(side), np.sin(side), rng.uniform(-0.2, 0.2)])
    return Rotation.random(random_state=rng).as_matrix(), place


def tracker_noise(xyz, spec, rng):
    """White noise u_range along the beam and u_angle * range across it in every direction."""
    distance = np.linalg.norm(xyz, axis=1, keepdims=True)
    beam = xyz / distance
    across = rng.standard_normal(xyz.shape)
    across -= beam * np.sum(beam * across, axis=1, keepdims=True)
    along = rng.standard_normal((len(xyz), 1))
    return spec.u_range * along * beam + spec.u_angle * distance * across


def record(machine, plan, rate=100.0, acceleration=2.0):
    """Programmed positions of a plan at the given sample rate."""
    (drive,) = drives_of(machine, plan, acceleration)
    time = np.arange(int(drive.duration * rate) + 1) / rate
    return Recording(machine, plan.path, time, drive.at(time))


def small_plan(machine, **parameters):
    """Planned path: few planes, little dwell."""
    defaults = {'levels': 2, 'passes': 1, 'corner_dwell': 0.05, 'end_dwell': 0.5}
    return plan_path(machine, PlannerConfig(**(defaults | parameters)))


def program(dialect, plan, header, machine=None):
    """NC program of a plan of one part, on a machine wide enough."""
    return part_program(
        dialect, machine or some_machine(ranges=3 * [(-900.0, 900.0)]), plan.parts[0], 1, header
    )


def on_increments(machine, plan):
    """The same plan at positions that a program can state."""
    return Plan(tuple(on_increment(machine, part) for part in plan.parts))


def plan_for_path(path, config):
    """Drive a path at one feed with a stop at every corner."""
    dwell = np.full(len(path.points), config.corner_dwell)
    dwell[[0, -1]] = config.end_dwell
    return Plan.along(path.points, np.full(len(dwell) - 1, config.feed), dwell)


def pieces_of(machine, path, tables, pose, size=0.01, count=10, *, exact=False):
    """Pieces as a perfect recording of a path would give them, errors of first order or exact."""
    corners, _ = path.corners()
    legs, points = [], []
    for j, (a, b) in enumerate(pairwise(corners)):
        number = max(3, int(np.linalg.norm(b - a) / size))
        share = (np.arange(number) + 0.5) / number
        points.append(a + share[:, None] * (b - a))
        legs.append(np.full(number, j))
    q, leg = np.concatenate(points), np.concatenate(legs)
    actual = position_of(tables, q) if exact else q + error_of(tables, q)
    inverse = (actual - pose.translation) @ pose.rotation
    unit = np.diff(corners, axis=0)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    n = len(q)
    ones = np.ones(n)
    return Pieces(
        q=q,
        step=unit[leg],
        spread=0.0 * ones,  # points on the path, not means along it
        xyz=inverse,
        nominal=q,
        direction=unit[leg],
        origin=corners[leg],
        part=np.zeros_like(leg),
        leg=leg,
        stretch=leg,
        side=sides_of_travel(unit)[leg],
        count=np.full(n, count),
        time=np.arange(n) * 0.01,
        duration=0.01 * ones,
        rate=np.zeros((n, 3)),
        speed=0.0 * ones,
        used=n * count,
    )


def grid_error(tables, truth, count=5):
    """Mean length on a lattice of truth, and of tables less truth, rigid motions taken out; m."""
    q = lattice(truth.machine, count)
    wanted = error_of(truth, q)
    left = without_rigid_motion(error_of(tables, q) - wanted, q)
    return mean_length(without_rigid_motion(wanted, q)), mean_length(left)


def transform_pose(machine, seed):
    """Pose of a tracker as the transform from its frame to the machine's."""
    rotation, place = some_pose(machine, np.random.default_rng(seed))
    return RigidTransform(rotation.T, place)


@dataclass(frozen=True)
class PieceFit:
    """Outcome of ``fit_pieces``."""

    tables: ErrorTables
    solution: Solution
    unknowns: Unknowns
    system: System
    normal: NormalEquations

    @property
    def missing(self):
        names = (*SQUARENESS, *MOTIONS)
        return {n for n in names if n not in self.solution.accepted}


def tables_of(machine, unknowns, solution):
    """Tables of the node values of a solution."""
    motions = {}
    for name in MOTIONS:
        value = solution.value[unknowns.blocks[name]]
        motions[name] = MotionTable(unknowns.knots[name[2]], value, np.zeros_like(value))
    places = {k: unknowns.blocks[k].start for k in SQUARENESS}
    return ErrorTables(
        machine, motions, {k: ScalarError(float(solution.value[i])) for k, i in places.items()}
    )


def white(machine):
    """Noise as specified, independent from sample to sample."""
    return NoiseModel.from_spec(machine.tracker, 1.0)


def fit_pieces(machine, pieces, pose, iterations=3, limit=1e-4, ranges=None):
    """Solve for given pieces: straight between nodes, hardly any prior, white noise."""
    nodes = table_nodes(machine, *(ranges or (machine.lower, machine.upper)))
    unknowns = layout(linear_bases(machine, nodes))
    prior = TIE_BREAK * smoothness(unknowns) / limit**2
    first = build_system(observed(machine, pieces, pose), unknowns, nodal_lever=True)
    whitener = Whitener.of(first, pieces, white(machine))
    accepted = identifiable_blocks(normal_equations(first, unknowns, whitener), unknowns, limit)
    tables = None
    for _ in range(iterations):
        system = build_system(observed(machine, pieces, pose), unknowns, tables)
        normal = normal_equations(system, unknowns, whitener)
        solution = solve(normal, unknowns, limit, accepted, prior)
        tables = tables_of(machine, unknowns, solution)
        pose = pose.moved_by(solution.value[:3], solution.value[3:6])
    return PieceFit(tables, solution, unknowns, system, normal)


def corner_path(machine, *shares):
    """Path through points given as shares of the axis ranges."""
    return NominalPath(machine.lower + np.array(shares, float) * (machine.upper - machine.lower))


def leg_parts(system, pieces, noise, misfit, component, low, high):
    """Parts of the covariance of one component of the pieces of one leg, all as matrices."""
    part = slice(low, high)
    windows = (pieces.time[part], pieces.duration[part], pieces.count[part])
    parts = covariance_parts(noise, misfit, system.shares[:, component, part], windows)
    return [np.diag(p) if p.ndim == 1 else p for p in parts]

# SPDX-License-Identifier: Apache-2.0
"""Cells drawn from a seed: what they hide and how large it is, their files, and the sealed key.

DIR/cells/NAME/bag (bag_2 from a second place of the tracker) and machine.yaml are all that a
diagnosis sees; DIR/key.json is opened for scoring only, and DIR/key.sha256, its hash, is told
before the first diagnosis.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from blind.effects import FOLLOWING, FORMS, NAMELESS, OTHER, PLAIN, SENSOR, TURNING, Form
from blind.machines import ROTARY_MACHINES, run_of_rotary, runs_of_three
from blind.nature import EPOCH_NS, Array, Errors, Moves, Rng, Run, View
from blind.observer import Observer

Entry = dict[str, Any]
KEY, SEAL = 'key.json', 'key.sha256'


@dataclass(frozen=True)
class Family:
    """A family of cells.

    Attributes
    ----------
    share : float
        Of the cells.
    sizes : tuple of float, m
        Smallest and largest of its effects, their logarithm evenly spread.
    displaced : bool
        True if that is the displacement itself where it acts, not what is left in the residual.
    seen : bool
        True if effects are drawn anew until they leave that much in the residual.
    small : bool
        True if small causes act besides.
    """

    share: float
    sizes: tuple[float, float] = (0.3e-6, 10e-6)
    displaced: bool = False
    seen: bool = False
    small: bool = False


THREE = {
    'none': Family(0.06),
    'one': Family(0.12, (0.7e-6, 10e-6)),
    'faint': Family(0.06, (0.3e-6, 0.7e-6)),
    'other form': Family(0.13, (1e-6, 6e-6)),
    'tilt': Family(0.08, (1e-6, 6e-6), seen=True),
    'large': Family(0.06, (20e-6, 30e-6), displaced=True),
    'mixture': Family(0.12, (0.7e-6, 6e-6), seen=True),
    'amid small': Family(0.10, (2e-6, 6e-6), seen=True, small=True),
    'small': Family(0.04, small=True),
    'unknown': Family(0.10, (1e-6, 6e-6)),
    'signal': Family(0.04, (1e-6, 6e-6)),
    'places': Family(0.04),
    'long': Family(0.05, (2e-6, 10e-6), seen=True),
}
"""Machines with three axes hide: nothing; an effect by its formula; a faint one; a known cause in
another form; a table that tilts; a very large one, of either; two or three of either; one of
either amid small ones; small ones alone; a cause of no catalogue; a known one that follows a
recorded temperature; an effect seen from two places of the tracker; one of either on a machine of
2 m to 6 m."""
ROTARY = {'rotary none': Family(0.33), 'rotary one': Family(0.45), 'rotary linear': Family(0.11),
          'rotary two': Family(0.11)}  # fmt: skip
"""Machines with rotary axes hide: nothing; a fault of a rotary axis; play or lag of a linear one;
two of either."""
LEFT_OUT = 'left out'
"""An effect by its formula that the diagnosis is to do without."""
SMALL, SMALL_COUNT = (0.1e-6, 0.5e-6), (4, 6)
"""m; sizes of small causes, and how many there are."""
DRAWS = 30
"""Draws of an effect until it leaves what it should."""
MOST, USUAL = 25e-6, 1.2
"""m; no displacement is drawn larger, but where it is the size; on machines with a diagonal longer
than ``USUAL``, m, in proportion."""
SEEN = (15.0, 60.0)
"""Standard deviations with which a perfect observer sees a fault of a rotary machine: three to
twelve times those from which a diagnosis is expected to find it."""
CLEAR = tuple(n for n, f in PLAIN.items() if not f.hard and not f.noise)
KNOWN = (*CLEAR, *OTHER)
TILTS = tuple(n for n in OTHER if n.startswith('other_tilt'))
PLACES = ('tracker_scale', 'tracker_range_offset', 'tracker_angles', 'table_tilt', 'target_offset',
          'target_incidence', 'cross_coupling', 'tracker_pose_drift', 'backlash')  # fmt: skip
WITHOUT = ('backlash', 'direction_dependent_tables', 'thermal_axis_expansion',
           'thermal_structure_drift', 'cross_coupling', 'servo_mismatch', 'corner_rounding',
           'tracker_pose_drift', 'cyclic_error', 'vibration', 'target_incidence')  # fmt: skip
TAKE_TURNS: dict[str, Sequence[str]] = {
    'one': tuple(PLAIN),
    'faint': CLEAR,
    'other form': tuple(n for n in OTHER if n not in TILTS),
    'tilt': TILTS,
    'large': tuple(n for pair in zip(CLEAR, OTHER, strict=False) for n in pair),
    'unknown': tuple(NAMELESS),
    'signal': tuple(FOLLOWING),
    'places': PLACES,
    LEFT_OUT: WITHOUT,
    'rotary one': tuple(n for n in TURNING if 'linear' not in n),
    'rotary linear': tuple(n for n in TURNING if 'linear' in n),
}
"""What the cells of a family hide in turn."""
OF_TRUNNION = {'turning_weight', 'turning_bearing', 'turning_incidence'}
"""Faults that need a tilting table."""
KIN = (
    {'backlash', 'direction_dependent_tables', 'servo_mismatch'},
    {'thermal_structure_drift', 'tracker_pose_drift'},
    {'cross_coupling', 'table_tilt', 'target_incidence', 'target_offset', 'tracker_angles',
     'tracker_range_offset', 'tracker_scale'},
)  # fmt: skip
"""Effects of which one can be the other: play that changes along an axis is a direction-dependent
table, and play that grows with the feed is a lag; a drift of the structure is one of the tracker;
all that depends on the place alone is, from one place of the tracker, a function of positions."""


@dataclass(frozen=True)
class Hidden:
    """One hidden effect: size and raw displacement (root mean squares, m), seen with ``snr``."""

    form: Form
    parameters: dict[str, float]
    size: float
    raw: float
    snr: float

    def scaled(self, factor: float) -> Hidden:
        """The same of another size."""
        sizes = (factor * v for v in (self.size, self.raw, self.snr))
        return Hidden(self.form, self.form.scaled(self.parameters, factor), *sizes)

    @property
    def visible_size(self) -> float:
        """Size; of a wave that means over pieces wash out that of the samples."""
        return max(self.size, self.raw if self.form.is_wave else 0.0)


@dataclass(frozen=True)
class Cell:
    """Runs of one machine, without what is hidden."""

    runs: tuple[Run, ...]

    @cached_property
    def observer(self) -> Observer:
        """Who knows all of them."""
        return Observer(self.runs)

    @cached_property
    def views(self) -> list[View]:
        """Of all parts of all runs."""
        return [View(r, k) for r in self.runs for k in range(len(r.parts))]

    def drawing(self, rng: Rng) -> View:
        """The first view, to draw parameters from."""
        view = copy(self.views[0])
        view.rng = rng
        return view

    def moves(self, hidden: Iterable[tuple[Form, dict[str, float]]]) -> list[Moves]:
        """What effects move together, part by part."""
        together: list[Moves] = [{} for _ in self.views]
        for form, p in hidden:
            for view, own in zip(self.views, together, strict=True):
                for key, move in form.moves(view, p).items():
                    own[key] = own[key] + move if key in own else move
        return together

    def displaced(self, hidden: Iterable[tuple[Form, dict[str, float]]]) -> list[Array]:
        """By what effects displace the reflector together, (n, 3), m, part by part."""
        return self.observer.displaced(self.moves(hidden))

    def weigh(self, form: Form, p: dict[str, float]) -> Hidden:
        """Measure an effect; a shift of everything alike is none."""
        moved = self.displaced([(form, p)])
        size, snr = self.observer.left(moved)
        raw = float(np.sqrt(np.mean(_lengths(moved) ** 2)))
        if form.is_wave:  # of single samples: means over pieces wash it out
            spec, beam = self.runs[0].machine.spec['tracker'], self.views[0].beam
            level = max(spec['u_range'], spec['u_angle'] * np.linalg.norm(beam, axis=1).mean())
            snr = max(snr, raw / level * np.sqrt(sum(map(len, moved))))
        return Hidden(form, p, size, raw, snr)


def _lengths(moved: Sequence[Array]) -> Array:
    """Displacement of all samples less its mean, shape (n,), m."""
    whole = np.concatenate(moved)
    return np.asarray(np.linalg.norm(whole - whole.mean(axis=0), axis=1))


def draw_hidden(
    cell: Cell, form: Form, family: Family, rng: Rng, sizes: tuple[float, float]
) -> Hidden:
    """Draw an effect with its size, anew where it has to be seen and leaves too little."""
    machine = cell.runs[0].machine
    low, high = machine.ends('XYZ')
    most = MOST * max(1.0, float(np.linalg.norm(high - low)) / USUAL)
    for _ in range(DRAWS):
        found = cell.weigh(form, form.draw(cell.drawing(rng)))
        if form.noise or found.raw == 0.0:
            return found
        wanted = float(np.exp(rng.uniform(*np.log(sizes))))
        length = _lengths(cell.displaced([(form, found.parameters)]))
        if family.displaced:
            acting = length[length > 0.02 * length.max()]
            factor = wanted / float(np.sqrt(np.mean(acting**2)))
        else:
            have, blurred = found.size, form.is_wave and found.size < 0.3 * found.raw
            if (form.hard and not family.seen) or blurred:
                wanted, have = 1.5 * wanted, found.raw
            factor = min(wanted / max(have, 1e-12), most / length.max())
        found = found.scaled(factor)
        if not family.seen or found.visible_size > 0.9 * sizes[0]:
            break
    return found


def draw_fault(cell: Cell, form: Form, rng: Rng) -> Hidden | None:
    """Draw a fault that is seen as it should be; None if none of ``DRAWS`` is."""
    wanted = float(np.exp(rng.uniform(*np.log(SEEN))))
    for _ in range(DRAWS):
        found = cell.weigh(form, form.draw(cell.drawing(rng)))
        if found.snr <= 0.0:  # as a reflector that is never placed again
            return None
        scaled = form.scaled(found.parameters, wanted / found.snr)
        moved = cell.displaced([(form, scaled)])
        if max(float(np.abs(m).max()) for m in moved) < MOST:
            return cell.weigh(form, scaled)
    return None


def _apart(count: int, rng: Rng, besides: Sequence[str] = ()) -> list[str]:
    """Draw causes no two of which have a name in common."""
    chosen = list(besides)
    for name in map(str, rng.permutation(KNOWN)):
        clash = any(FORMS[name].names & FORMS[other].names for other in chosen)
        if len(chosen) < count + len(besides) and not clash:
            chosen.append(name)
    return chosen[len(besides) :]


def draw_names(kind: str, turn: int, rng: Rng) -> list[str]:
    """Draw what a cell hides, but for small causes; ``turn``: how many of its kind came before."""
    if known := TAKE_TURNS.get(kind):
        return [known[turn % len(known)]]
    if kind == 'rotary two':
        return [str(n) for n in rng.choice(TAKE_TURNS['rotary one'], 2, replace=False)]
    if kind == 'mixture':
        return _apart(2 + turn % 2, rng)
    if kind == 'long' and turn % 2:
        return [TILTS[int(rng.integers(len(TILTS)))]]
    return _apart(int(kind in ('amid small', 'long')), rng)


def draw_cell(kind: str, rng: Rng, names: Sequence[str] = ()) -> Cell:
    """Draw the runs of a cell, on a machine that can hide what is named."""
    if kind not in ROTARY:
        places = 2 if kind == 'places' else 1
        return Cell(tuple(runs_of_three(rng, places, large=kind == 'long',
                                        sensor=kind == 'signal')))  # fmt: skip
    fitting = ['trunnion'] if OF_TRUNNION & set(names) else list(ROTARY_MACHINES)
    shares = np.array([ROTARY_MACHINES[m] for m in fitting])
    return Cell((run_of_rotary(str(rng.choice(fitting, p=shares / shares.sum())), rng),))


def draw(seed: int, name: str, kind: str, turn: int) -> tuple[Cell, list[Hidden]]:
    """Draw one cell and what it hides."""
    rng = np.random.default_rng([seed, *name.encode()])
    family, names = {**THREE, **ROTARY, LEFT_OUT: THREE['one']}[kind], draw_names(kind, turn, rng)
    forms = [FORMS[n] for n in names]
    if kind in ROTARY:
        while True:
            cell = draw_cell(kind, rng, names)
            faults = [draw_fault(cell, form, rng) for form in forms]
            if all(faults):
                return cell, faults
    cell = draw_cell(kind, rng)
    hidden = [draw_hidden(cell, form, family, rng, family.sizes) for form in forms]
    if family.small:
        count = int(rng.integers(SMALL_COUNT[0], SMALL_COUNT[1] + 1))
        hidden += [draw_hidden(cell, FORMS[n], family, rng, SMALL)
                   for n in _apart(count, rng, names)]  # fmt: skip
    return cell, hidden


def orders(trials: int, rotary: int, leave_out: int, seed: int) -> list[tuple[str, str, int]]:
    """Name, kind and turn of every cell, kinds by their shares in random order."""
    rng, cells = np.random.default_rng([seed, 0]), []
    for head, count, families in (('', trials, THREE), ('r', rotary, ROTARY)):
        names, shares = list(families), np.array([f.share for f in families.values()])
        wanted = shares / shares.sum() * count
        numbers = np.floor(wanted).astype(int)
        for k in np.argsort(numbers - wanted)[: count - numbers.sum()]:
            numbers[k] += 1
        start = rng.integers(0, 1000, len(names)).tolist()
        own = [(n, s + i) for n, c, s in zip(names, numbers, start, strict=True) for i in range(c)]
        cells += [(f'{head}{k:03d}', *own[i]) for k, i in enumerate(rng.permutation(len(own)))]
    return cells + [(f'x{k:03d}', LEFT_OUT, k) for k in range(leave_out)]


# Files.


def write_bag(folder: Path, run: Run, stamps: Array, points: Array) -> None:
    """Write a recording as others write it, with rosbags alone."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)

    def new(kind: str, *values: Any) -> Any:
        return store.types[kind](*values)

    def header(at: int, frame: str) -> Any:
        return new('std_msgs/msg/Header', new('builtin_interfaces/msg/Time', *divmod(at, 10**9)),
                   frame)  # fmt: skip

    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def topic(name: str, kind: str) -> Callable[[int, Any], None]:
            channel = writer.add_connection(name, kind, typestore=store)
            return lambda at, message: writer.write(
                channel, at, store.serialize_cdr(message, kind)
            )

        if run.machine.turning:
            say = topic('/planner/axes', 'trajectory_msgs/msg/JointTrajectory')
            for k, part in enumerate(run.parts):
                at, still = EPOCH_NS + k, np.zeros(0)
                corners = [new('trajectory_msgs/msg/JointTrajectoryPoint', q, still, still, still,
                               new('builtin_interfaces/msg/Duration', 0, 0))
                           for q in part.corners]  # fmt: skip
                say(at, new('trajectory_msgs/msg/JointTrajectory', header(at, part.target),
                            run.machine.letters, corners))  # fmt: skip
        else:
            upright = new('geometry_msgs/msg/Quaternion', 0.0, 0.0, 0.0, 1.0)
            head = header(EPOCH_NS, 'machine')
            poses = [new('geometry_msgs/msg/PoseStamped', head, new(
                'geometry_msgs/msg/Pose', new('geometry_msgs/msg/Point', *map(float, q)), upright))
                for q in run.parts[0].corners]  # fmt: skip
            say = topic('/planner/path', 'nav_msgs/msg/Path')
            say(EPOCH_NS, new('nav_msgs/msg/Path', head, poses))
        if len(run.warmth[0]):
            say = topic(SENSOR, 'sensor_msgs/msg/Temperature')
            for time, value in zip(*run.warmth, strict=True):
                at = EPOCH_NS + round(1e9 * float(time) * (1.0 + run.drift))
                if at < stamps[-1]:
                    say(at, new('sensor_msgs/msg/Temperature', header(at, ''), float(value), 0.0))
        say = topic('/tracker/point', 'geometry_msgs/msg/PointStamped')
        for at, xyz in zip(stamps.tolist(), points.tolist(), strict=True):
            say(at, new('geometry_msgs/msg/PointStamped', header(at, 'tracker'),
                        new('geometry_msgs/msg/Point', *xyz)))  # fmt: skip


def write_cell(folder: Path, seed: int, name: str, kind: str, turn: int) -> Entry:
    """Draw one cell, write what a diagnosis may see, return its entry of the key."""
    cell, hidden = draw(seed, name, kind, turn)
    own = folder / 'cells' / name
    shutil.rmtree(own, ignore_errors=True)
    own.mkdir(parents=True)
    (own / 'machine.yaml').write_text(yaml.safe_dump(cell.runs[0].machine.spec, sort_keys=False))
    chance = np.random.default_rng([seed, *name.encode(), 1]).uniform(size=2)
    tails = 3.0 + 2.0 * float(chance[1]) if kind not in ROTARY and chance[0] < 0.15 else None
    moved = cell.displaced([(h.form, h.parameters) for h in hidden])
    quiet: list[Array] = []
    for k, run in enumerate(cell.runs):
        noise = run.noise if tails is None else replace(run.noise, dof=tails)
        for h in hidden:
            noise = h.form.noise(noise, h.parameters) if h.form.noise else noise
        parts = slice(k * len(run.parts), (k + 1) * len(run.parts))
        shown = [a + b for a, b in zip(run.plain, moved[parts], strict=True)]
        stamps, points = run.measured(shown, noise)
        write_bag(own / ('bag' if k == 0 else f'bag_{k + 1}'), run, stamps, points)
        cuts = np.cumsum([len(p) for p in shown])[:-1]
        seen = np.split(points @ run.rotation.T + run.tracker, cuts)
        quiet += [s - p for s, p in zip(seen, shown, strict=True)]
    loud = [a + b for a, b in zip(quiet, moved, strict=True)]
    return {
        'cell': name,
        'kind': kind,
        'turn': turn,
        'hidden': [_entry(h) for h in hidden],
        'measured_um': 1e6 * cell.observer.left(loud)[0],
        'simulated_um': 1e6 * cell.observer.left(quiet)[0],
        'bends_um': 1e6 * cell.observer.left(_bends(cell))[0],
        'heavy_tails': tails is not None,
        'without': sorted(kin_of(hidden[0].form.name)) if kind == LEFT_OUT else [],
    }


def _entry(h: Hidden) -> Entry:
    p = {n: float(v) for n, v in h.parameters.items()}
    sizes = {'size_um': 1e6 * h.size, 'raw_um': 1e6 * h.raw, 'snr': float(h.snr)}
    return {'form': h.form.name, 'names': sorted(h.form.names), 'parameters': p, **sizes}


def _bends(cell: Cell) -> list[Array]:
    """What the errors do between the nodes of the tables, part by part, (n, 3), m."""

    def nodal(name: str, run: Run):
        nodes = run.machine.nodes(name[2])
        values = run.errors.motions[name](nodes)
        return lambda q: np.interp(q, nodes, values)

    found = []
    for run in cell.runs:
        tables = Errors({n: nodal(n, run) for n in run.errors.motions}, run.errors.constants)
        found += [p - run.seen(k, errors=tables) for k, p in enumerate(run.plain)]
    return found


def kin_of(name: str) -> set[str]:
    """An effect and those it can be, all to be taken out of the catalogue with it."""
    return next((k for k in KIN if name in k), {name})


def seal(folder: Path, content: dict[str, Any]) -> str:
    """Write the key and its hash, which is returned."""
    text = json.dumps(content, indent=1)
    (folder / KEY).write_text(text)
    digest = hashlib.sha256(text.encode()).hexdigest()
    (folder / SEAL).write_text(digest + '\n')
    return digest


def open_key(folder: Path) -> dict[str, Any]:
    """Read the key; ValueError if it is not the one that was sealed."""
    text = (folder / KEY).read_text()
    if hashlib.sha256(text.encode()).hexdigest() != (folder / SEAL).read_text().strip():
        raise ValueError(f'{folder / KEY}: is not the key that was sealed')
    return json.loads(text)

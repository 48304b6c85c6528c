# SPDX-License-Identifier: Apache-2.0
"""A machine with rotary axes as it is: exact transforms, and what is wrong inside their chain.

p_w = T_1(q_1) ... T_n(q_n) p. Of an axis that carries the table, the joint acts between table and
bed, so what shifts its carrier stands on the other side than for an axis that carries the tool.
Nothing here is shared with the model, the simulation or the catalogue of effects: faults move
joints, carriers, reflectors and ranges where they arise, and the chain turns that into positions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array

Rng = np.random.Generator
Transform = tuple[Array, Array]
Spec = dict[str, Any]
"""Content of machine.yaml."""
LINEAR, ROTARY = 'XYZ', 'ABC'
LOCATION = {
    'A': ('Y0A', 'Z0A', 'B0A', 'C0A'),
    'B': ('X0B', 'Z0B', 'A0B', 'C0B'),
    'C': ('X0C', 'Y0C', 'A0C', 'B0C'),
}
SQUARE = ('C0Y', 'B0Z', 'A0Z')
SIX = 'XYZABC'


def turned(v: Array) -> Array:
    """Rotation matrices of rotation vectors (..., 3), rad, after Rodrigues."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    k = np.zeros((*v.shape[:-1], 3, 3))
    k[..., 1, 0], k[..., 2, 0], k[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    k -= np.swapaxes(k, -1, -2)
    half = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * k + half * (k @ k))


def chained(f: Transform, g: Transform) -> Transform:
    """First g, then f."""
    return f[0] @ g[0], (f[0] @ g[1][..., None])[..., 0] + f[1]


def undone(f: Transform) -> Transform:
    """Inverse."""
    back = np.swapaxes(f[0], -1, -2)
    return back, -(back @ f[1][..., None])[..., 0]


def moved(d: Array, centre: Array) -> Transform:
    """Shift d[:3] after a rotation d[3:] about a point."""
    r = turned(d[..., 3:])
    return r, d[..., :3] + centre - r @ centre


Motion = Callable[[Array], Array]


@dataclass(frozen=True)
class Errors:
    """Errors that calibrations look for: motions as functions of the position, constants."""

    motions: Mapping[str, Motion] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)


def draw_errors(machine: Nature, rng: Rng) -> Errors:
    """Draw smooth motions of some 20 um and 50 urad, location and squareness errors."""
    motions, constants = {}, {}
    for axis in machine.letters:
        for letter in SIX:
            size = (8e-6 if axis in ROTARY else 15e-6) if letter in LINEAR else 40e-6
            motions[f'E{letter}{axis}'] = _wave(rng, machine, axis, size)
        for name in LOCATION.get(axis, ()):
            size = 30e-6 if name[0] in LINEAR else 60e-6
            constants[name] = size * rng.uniform(0.4, 1.2) * rng.choice((-1.0, 1.0))
    constants |= {name: 60e-6 * rng.uniform(-1.0, 1.0) for name in SQUARE}
    return Errors(motions, constants)


def _wave(rng: Rng, machine: Nature, axis: str, size: float) -> Motion:
    """A few waves over the range, zero at its lower end; of an endless axis whole ones."""
    low, high = machine.range_of(axis)
    if machine.spec['axes'][axis].get('endless'):
        number, share = np.arange(1.0, 4.0), np.array([0.8, 0.5, 0.2])
    else:
        number, share = np.array([0.2, 0.45, 0.75, 1.1]), np.array([1.0, 0.7, 0.4, 0.15])
        number = number * rng.uniform(0.9, 1.1, 4)
    amplitude = size * share * rng.normal(size=len(share))
    rate, phase = 2 * np.pi * number / (high - low), rng.uniform(0, 2 * np.pi, len(share))

    def value(q: Array) -> Array:
        waves = np.sin(rate * (np.asarray(q)[..., None] - low) + phase) - np.sin(phase)
        return np.asarray(waves @ amplitude)

    return value


@dataclass(frozen=True)
class Driven:
    """What was driven in one part.

    Attributes
    ----------
    program : callable(time) -> ndarray, shape (n, k), m and rad
        Programmed positions, of times in this part, s.
    clock : ndarray, shape (n,), s
        Of the samples since the part began.
    start, length : float, s
        When the part began in the run, and how long the run is.
    target : str
        Reflector in view.
    again : bool
        True if it was in view before.
    """

    program: Callable[[Array], Array]
    clock: Array
    start: float
    length: float
    target: str
    again: bool = False

    @cached_property
    def q(self) -> Array:
        """Programmed positions at the samples."""
        return self.program(self.clock)

    @cached_property
    def moves(self) -> NDArray[np.bool_]:
        """Which axes move at the samples, shape (n, k)."""
        return np.abs(np.diff(self.q, axis=0, prepend=self.q[:1])) > 1e-10

    @property
    def time(self) -> Array:
        """Of the samples since the run began, s."""
        return self.start + self.clock


@dataclass(frozen=True)
class Fault:
    """Something wrong.

    Attributes
    ----------
    kind : str
        Of ``depends.FAULTS``.
    axis : str
        Of which axis; '' for none.
    size : float
        m, rad, s or m per rad^2: everything it does is in proportion to it.
    shape : mapping of str to float
    """

    kind: str
    axis: str
    size: float
    shape: Mapping[str, float] = field(default_factory=dict)

    def scaled(self, factor: float) -> Fault:
        """The same of another size."""
        return replace(self, size=self.size * factor)

    def vector(self, name: str) -> Array:
        """Three numbers of the shape: name_0, name_1, name_2."""
        return np.array([self.shape.get(f'{name}_{k}', 0.0) for k in range(3)])


@dataclass(frozen=True)
class Nature:
    """The machine.

    Attributes
    ----------
    spec : dict
        Content of its machine.yaml.
    """

    spec: Spec

    @cached_property
    def letters(self) -> list[str]:
        """Its axes, in the order of positions."""
        return [a for a in SIX if a in self.spec['axes']]

    @cached_property
    def order(self) -> list[str]:
        """Its axes from the table to the tool."""
        return [a for a in str(self.spec['chain']).split('-') if a not in 'wbt']

    @cached_property
    def table_side(self) -> list[str]:
        """Those between table and bed."""
        parts = str(self.spec['chain']).split('-')
        return parts[1 : parts.index('b')]

    @property
    def turning(self) -> list[str]:
        """Rotary axes."""
        return [a for a in self.letters if a in ROTARY]

    def column(self, axis: str) -> int:
        """Column of the positions."""
        return self.letters.index(axis)

    def range_of(self, axis: str) -> tuple[float, float]:
        """Travel, m or rad."""
        one = self.spec['axes'][axis]
        return one['min'], one['max']

    def nodes(self, axis: str) -> Array:
        """Evenly spaced positions at most a table pitch apart."""
        low, high = self.range_of(axis)
        count = int(np.ceil((high - low) / self.spec['axes'][axis]['table_pitch'] - 1e-9))
        return np.linspace(low, high, count + 1)

    def target(self, name: str) -> tuple[str, Array]:
        """Link and nominal place of a reflector, m."""
        one = self.spec.get('targets', {}).get(name, {})
        own = one.get('place', self.spec['target_offset'])
        return one.get('link', 't'), np.array(own, dtype=float)

    def joint(
        self, axis: str, q: Array, errors: Errors, carrier: Array | None = None
    ) -> Transform:
        """Transform of one axis at positions (n,); ``carrier``: shifts and turns (n, 6) of it."""
        d = np.zeros((len(q), 6))
        for k, letter in enumerate(SIX):
            if motion := errors.motions.get(f'E{letter}{axis}'):
                d[:, k] = motion(q)
        known, one = errors.constants, self.spec['axes'][axis]
        if axis in LINEAR:
            centre, along = np.zeros(3), np.eye(3)[LINEAR.index(axis)]
            if axis == 'Y':
                along = along - np.array([known.get('C0Y', 0.0), 0.0, 0.0])
            if axis == 'Z':
                along = along + np.array([known.get('B0Z', 0.0), -known.get('A0Z', 0.0), 0.0])
            move: Transform = np.tile(np.eye(3), (len(q), 1, 1)), q[:, None] * along
            outside = axis in self.table_side
        else:
            centre = np.array(one['centre'], dtype=float)
            direction = np.array(one['direction'], dtype=float)
            move = moved(
                np.concatenate([np.zeros((len(q), 3)), q[:, None] * direction], axis=1), centre
            )
            place = np.zeros(6)
            for name in LOCATION[axis]:
                place[SIX.index(name[0])] = known.get(name, 0.0)
            line = moved(np.tile(place, (len(q), 1)), centre)
            move = chained(chained(line, move), undone(line))
            outside = axis not in self.table_side
        off = moved(d, centre)
        move = chained(off, move) if outside else chained(move, off)
        if carrier is None:
            return move
        shift = moved(carrier, centre)
        return chained(move, shift) if axis in self.table_side else chained(shift, move)

    def link(
        self,
        q: Array,
        errors: Errors,
        seen_from: str,
        link: str,
        carriers: Mapping[str, Array] | None = None,
    ) -> Transform:
        """Transforms of a link (w, b or t) seen from another one."""
        where: dict[str, Transform] = {}
        now: Transform = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
        needed = {seen_from, link}
        sides = {'w': self.table_side, 't': [a for a in self.order if a not in self.table_side]}
        where['b'] = now
        for end, own in sides.items():
            where[end] = now
            if end in needed:
                for axis in own:
                    carrier = (carriers or {}).get(axis)
                    one = self.joint(axis, q[:, self.column(axis)], errors, carrier)
                    where[end] = chained(where[end], one)
        where['w'] = undone(where['w'])
        return chained(undone(where[seen_from]), where[link])

    def place(
        self,
        q: Array,
        errors: Errors,
        link: str,
        place: Array,
        carriers: Mapping[str, Array] | None = None,
    ) -> Array:
        """Positions (n, 3) of a point of a link, seen from the link of the tracker, m."""
        r, p = self.link(q, errors, self.tracker_link, link, carriers)
        return np.asarray(r @ place + p)

    @property
    def tracker_link(self) -> str:
        """What the tracker stands on."""
        return str(self.spec['tracker'].get('link', 'w'))

    def seen(
        self,
        part: Driven,
        errors: Errors,
        places: Mapping[str, Array],
        tracker: Array,
        faults: Sequence[Fault] = (),
    ) -> Array:
        """Where the tracker at a place sees the reflector of a part, (n, 3), m."""
        q = part.program(part.clock)
        link, place = self.target(part.target)[0], places[part.target]
        for fault in faults:
            if act := JOINTS.get(fault.kind):
                q[:, self.column(fault.axis)] += act(fault, self, part)
            if fault.kind == 'reseating' and part.again:
                place = place + fault.size * fault.vector('along')
        carriers: dict[str, Array] = {}
        for fault in faults:
            if carry := CARRIERS.get(fault.kind):
                before = carriers.get(fault.axis, np.zeros((len(q), 6)))
                carriers[fault.axis] = before + carry(fault, self, part)
        position = self.place(q, errors, link, place, carriers)
        for fault in faults:
            if fault.kind == 'incidence':
                position = position + _range_error(fault, self, part, position, tracker)
        return position


# What acts at a joint: change of its position, shape (n,), m or rad.


def _play(fault: Fault, machine: Nature, part: Driven) -> Array:
    """The joint is pushed by a drive with play, and stays where it was left."""
    half = 0.5 * abs(fault.size)
    programmed = part.q[:, machine.column(fault.axis)]
    own = np.empty_like(programmed)
    now = programmed[0]
    for k, wanted in enumerate(programmed.tolist()):
        now = min(max(now, wanted - half), wanted + half)
        own[k] = now
    return np.asarray(np.sign(fault.size) * (own - programmed))


def _late(fault: Fault, machine: Nature, part: Driven) -> Array:
    """The joint is where it should have been a moment before."""
    k = machine.column(fault.axis)
    return np.asarray(part.program(part.clock - fault.size)[:, k] - part.q[:, k])


def _gear(fault: Fault, machine: Nature, part: Driven) -> Array:
    """Teeth, pitch errors and a trace of their second harmonic."""
    angle = fault.shape['number'] * part.q[:, machine.column(fault.axis)] + fault.shape['phase']
    return np.asarray(fault.size * (np.sin(angle) + 0.1 * np.sin(2.0 * angle)))


def _weight(fault: Fault, machine: Nature, part: Driven) -> Array:
    """A weight off the axis pulls at the tilting axis by its lever across it."""
    r, _ = machine.link(part.q, Errors(), 'b', 'w')
    lever = r @ fault.vector('off')
    direction = np.array(machine.spec['axes'][fault.axis]['direction'], dtype=float)
    across = np.cross([0.0, 0.0, 1.0], direction)
    return np.asarray(fault.size * (lever @ across))


JOINTS = {'play': _play, 'late': _late, 'gear': _gear, 'weight': _weight}

# What acts on the carrier of an axis: shifts and turns, shape (n, 6), m and rad.


def _soft_bearing(fault: Fault, machine: Nature, part: Driven) -> Array:
    """The rotor leans to one of its sides the more the other axis tilts it."""
    own = part.q[:, machine.column(fault.axis)] + fault.shape['phase']
    other = next(a for a in machine.turning if a != fault.axis)
    tilt = fault.size * np.sin(part.q[:, machine.column(other)])
    six = np.zeros((len(own), 6))
    six[:, 3], six[:, 4] = tilt * np.cos(own), tilt * np.sin(own)
    return six


def _warm(fault: Fault, machine: Nature, part: Driven) -> Array:
    """The housing grows after a cold start."""
    tau = fault.shape['tau'] * part.length
    course = 1.0 - np.exp(-part.time / tau)
    six = np.zeros((len(course), 6))
    six[:, :3] = fault.size * course[:, None] * fault.vector('along')
    return six


def _brake(fault: Fault, machine: Nature, part: Driven) -> Array:
    """The brake of an axis that stands pulls it aside."""
    stands = ~part.moves[:, machine.column(fault.axis)]
    six = np.concatenate([fault.vector('along'), fault.vector('about')])
    return np.asarray(fault.size * stands[:, None] * six)


CARRIERS = {'bearing': _soft_bearing, 'warm': _warm, 'brake': _brake}


def _range_error(
    fault: Fault, machine: Nature, part: Driven, position: Array, tracker: Array
) -> Array:
    """Shift along the beam by the angle at which it meets the axis of the reflector, (n, 3), m.

    The reflector was turned to the tracker when the part began.
    """
    r, _ = machine.link(part.q, Errors(), machine.tracker_link, machine.target(part.target)[0])
    beam = position - tracker
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    inside = np.einsum('nji,nj->ni', r, beam)
    angle = np.arccos(np.clip(inside @ inside[0], -1.0, 1.0))
    return np.asarray(beam * (fault.size * angle ** fault.shape['power'])[:, None])

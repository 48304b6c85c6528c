# SPDX-License-Identifier: Apache-2.0
"""Machine description: kinematic chain, axis ranges, node pitch, target offset, tracker.

The chain string runs from workpiece to tool, e.g. ``w-Y-b-X-Z-t``: axes between ``w`` and ``b``
carry the table, axes between ``b`` and ``t`` carry the target.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError
from otf_core.files.strict_yaml import Fields, parse_yaml, read_yaml_bytes
from otf_core.model.motions import (
    AXES,
    DIRECTIONS,
    LETTERS,
    ROTARY,
    SQUARENESS,
    ErrorMotion,
    location_names,
)
from otf_core.model.presets import TRACKERS, chosen
from otf_core.model.sections import (
    TARGET_OFFSET,
    Circumstances,
    DeclaredUncertainty,
    Limits,
    SignalSpec,
    circumstances_from_fields,
    declared_from_fields,
    limits_from_fields,
    signals_from_fields,
)
from otf_core.model.surroundings import Surroundings, surroundings_from_fields

KEYS = (
    'name', 'chain', 'axes', 'target_offset', 'tracker', 'uncertainty', 'limits', 'instrument',
    'conditions', 'certificate', 'signals', 'targets', 'surroundings',
)  # fmt: skip
"""Of machine.yaml; all from ``uncertainty`` on are optional."""


TOOL = 'tool'
"""Target that every machine has: at ``target_offset``."""
TABLE, BED, SPINDLE = 'w', 'b', 't'
"""Links of a machine by their letters in the chain."""
MOST_ROTARY = 2
FURTHEST_CENTRE = 10.0
"""m; lines of rotary axes run nearer to the origin of the machine."""
LARGEST_ANGLE = 100.0
"""rad; ends of the range of a rotary axis, turned several times, stay below."""
FULL_TURN = 2.0 * math.pi
USUAL_U = {TABLE: 1e-3, SPINDLE: 1e-5}
"""m; standard uncertainty of the place of a target where none is stated, by link; of ``tool`` 0. A
second length in a spindle that leans by 100 urad is 10 um aside."""
USUAL_U_FACING = 3e-6
"""m; standard uncertainty of every coordinate of the centre of a reflector after it is turned in
its nest, where none is stated."""
MOST_FACINGS = 12
"""Of one reflector."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Axis:
    """Travel of one axis: ``min``, ``max`` and nominal node spacing, m, or rad where it turns.

    Attributes
    ----------
    direction : tuple of float, optional
        Of a rotary axis alone: unit vector about which the target turns right-handed relative to
        the table.
    centre : tuple of float
        m; a point of that line, machine coordinates, all axes at zero.
    endless : bool
        Errors repeat after a full turn.
    """

    min: float
    max: float
    table_pitch: float
    direction: Vector | None = None
    centre: Vector = (0.0, 0.0, 0.0)
    endless: bool = False

    @property
    def rotary(self) -> bool:
        """Return whether the axis turns."""
        return self.direction is not None

    @property
    def unit(self) -> str:
        """Of its positions: m or rad."""
        return 'rad' if self.rotary else 'm'

    @property
    def shown(self) -> tuple[float, str]:
        """Factor and unit of its positions for people: mm or degrees."""
        return (180.0 / math.pi, 'deg') if self.rotary else (1e3, 'mm')

    def wrapped(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions (any shape) at which errors are known: an endless axis within one turn."""
        if not self.endless:
            return q
        turned = self.min + np.mod(q - self.min, FULL_TURN)
        return np.where((q >= self.min) & (q <= self.max), q, turned)

    def to_dict(self) -> dict[str, Any]:
        """Layout of machine.yaml."""
        data: dict[str, Any] = {
            'min': self.min,
            'max': self.max,
            'table_pitch': self.table_pitch,
        }
        if self.direction is None:
            return data
        return {
            'kind': 'rotary',
            **data,
            'direction': list(self.direction),
            'centre': list(self.centre),
            'endless': self.endless,
        }


@dataclass(frozen=True)
class Target:
    """A place that holds a reflector.

    Attributes
    ----------
    link : str
        ``w`` on the table, ``t`` on the tool side.
    place : tuple of float
        m, in the frame of its link: machine coordinates, all axes at zero.
    u : float
        m; standard uncertainty of every coordinate, 0 for a known place.
    facings : int
        Directions to which the operator may turn a reflector in its nest, see ``Machine.targets``.
    u_facing : float
        m; standard uncertainty of every coordinate of its centre after it is turned.
    nest : str
        Name of the target of which it is a facing; empty where there is one facing alone.
    """

    link: str
    place: Vector
    u: float = 0.0
    facings: int = 1
    u_facing: float = 0.0
    nest: str = ''

    def to_dict(self) -> dict[str, Any]:
        """Layout of machine.yaml."""
        data: dict[str, Any] = {'link': self.link, 'place': list(self.place), 'u': self.u}
        if self.facings > 1:
            data |= {'facings': self.facings, 'u_facing': self.u_facing}
        return data


@dataclass(frozen=True)
class TrackerSpec:
    """Specified standard uncertainties: ``u_range`` in m along the beam, ``u_angle`` in rad.

    ``preset`` names the class of tracker that what is not given comes from; ``link`` is what the
    tracker stands on, table (``w``) or bed (``b``).
    """

    u_range: float
    u_angle: float
    preset: str | None = None
    link: str = TABLE


@dataclass(frozen=True)
class Chain:
    """Kinematic chain, workpiece to tool.

    Attributes
    ----------
    table_side : tuple of str
        Axes that carry the table, in order from the workpiece to the base.
    target_side : tuple of str
        Axes that carry the target, in order from the base to the tool.
    """

    table_side: tuple[str, ...]
    target_side: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> Chain:
        """Return the chain of a string like ``w-Y-b-X-Z-t``; ConfigError if it is none."""
        parts = text.split('-')
        inner = parts[1:-1]
        axes = [p for p in inner if p != 'b']
        wrong = [p for p in axes if p not in LETTERS]
        twice = [p for p in dict.fromkeys(axes) if axes.count(p) > 1]
        turning = [p for p in axes if p in ROTARY]
        reason = ''
        if parts[0] != 'w' or parts[-1] != 't' or inner.count('b') != 1:
            reason = 'it runs from w over the base b, once, to t'
        elif wrong:
            reason = f"'{wrong[0]}' is no axis; axes are {', '.join(LETTERS)}"
        elif twice:
            reason = f'{twice[0]} stands there more than once'
        elif not axes:
            reason = 'it has no axis'
        elif len(turning) > MOST_ROTARY:
            reason = f'it has {len(turning)} rotary axes, {MOST_ROTARY} at most'
        if reason:
            raise ConfigError(
                f"chain: '{text}' is not a kinematic chain: {reason}; write w, the axes (X, Y, Z, "
                f'up to {MOST_ROTARY} of A, B, C) and the base b between them, then t, as in '
                f"'w-Y-b-X-Z-t'"
            )
        base = inner.index('b')
        return cls(tuple(inner[:base]), tuple(inner[base + 1 :]))

    def __str__(self) -> str:
        """Return the chain string."""
        return '-'.join(['w', *self.table_side, 'b', *self.target_side, 't'])

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Its axes, in the order of the columns of positions."""
        own = (*self.table_side, *self.target_side)
        return tuple(a for a in LETTERS if a in own)

    @property
    def motions(self) -> tuple[ErrorMotion, ...]:
        """Error motions of all axes: EXX, EYX ... ECX, EXY ..."""
        return tuple(ErrorMotion(d, axis) for axis in self.axis_names for d in DIRECTIONS)

    @property
    def squareness(self) -> tuple[str, ...]:
        """Squareness errors of its linear axes; fewer than two have none."""
        about = {n: AXES[ROTARY.index(n[0])] for n in SQUARENESS}
        return tuple(n for n in SQUARENESS if {*AXES} - {about[n]} <= {*self.axis_names})

    @property
    def location(self) -> tuple[str, ...]:
        """Location errors of its rotary axes, such as X0C."""
        rotary = (a for a in self.axis_names if a in ROTARY)
        return tuple(n for axis in rotary for n in location_names(axis))

    def lever_axes(self, axis: str) -> tuple[str, ...]:
        """Axes whose travel is part of the lever arm L of an axis (docs/conventions.md)."""
        if axis in self.target_side:
            return self.target_side[self.target_side.index(axis) + 1 :]
        return self.table_side[self.table_side.index(axis) :] + self.target_side


@dataclass(frozen=True)
class Machine:
    """One machine: its chain of one to three linear and up to two rotary axes, and its tracker.

    Attributes
    ----------
    axes : mapping of axis name to Axis
    target_offset : ndarray, shape (3,), m
        From the last target-side frame to the target, all frames coinciding at q = 0.
    uncertainty : DeclaredUncertainty, optional
        Standard uncertainties that no run shows.
    limits : Limits, optional
        What a calibration is judged by.
    stated : Circumstances
        Instrument, conditions and certificate, for reports alone.
    signals : tuple of SignalSpec
        What is recorded beside the samples.
    targets : mapping of str to Target
        Places of reflectors; ``tool`` is at ``target_offset``.
    surroundings : Surroundings
        Half-angle of reflectors, and bodies, for plans alone.
    file_sha256 : str
        SHA-256 of the file it was read from; empty if there is none.
    """

    name: str
    chain: Chain
    axes: Mapping[str, Axis]
    target_offset: NDArray[np.float64]
    tracker: TrackerSpec
    uncertainty: DeclaredUncertainty | None = None
    limits: Limits | None = None
    stated: Circumstances = field(default_factory=Circumstances)
    signals: tuple[SignalSpec, ...] = ()
    file_sha256: str = field(default='', repr=False, compare=False)
    stated_targets: Mapping[str, Target] = field(default_factory=dict)
    surroundings: Surroundings = field(default_factory=Surroundings)

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Its axes, in the order of the columns of positions."""
        return self.chain.axis_names

    @property
    def rotary_names(self) -> tuple[str, ...]:
        """Its rotary axes."""
        return tuple(a for a in self.axis_names if self.axes[a].rotary)

    @cached_property
    def motions(self) -> tuple[ErrorMotion, ...]:
        """Error motions of all axes: EXX, EYX ... ECX, EXY ..."""
        return self.chain.motions

    @property
    def squareness(self) -> tuple[str, ...]:
        """Squareness errors of its linear axes; fewer than two have none."""
        return self.chain.squareness

    @property
    def location(self) -> tuple[str, ...]:
        """Location errors of its rotary axes, such as X0C."""
        return self.chain.location

    @property
    def scalars(self) -> tuple[str, ...]:
        """Squareness and location errors in the order of a covariance."""
        return (*self.squareness, *self.location)

    @property
    def point_names(self) -> tuple[str, ...]:
        """Columns of points in files: X, Y, Z, whether there is such an axis or not, and A, B, C.

        Positions along what is no axis are zero.
        """
        return (*AXES, *self.rotary_names)

    def axis_positions(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Axis positions (n, k), m and rad, of points with the columns ``point_names``."""
        return points[:, [self.point_names.index(a) for a in self.axis_names]]

    @cached_property
    def targets(self) -> dict[str, Target]:
        """All places of reflectors by name, ``tool`` first.

        A reflector that is turned to other facings is a target of its own in each: ``nest``,
        ``nest-facing-2``, ``nest-facing-3`` ...
        """
        own = self.stated_targets.get(TOOL)
        offset = (*(float(v) for v in self.target_offset),)
        tool = Target(SPINDLE, (offset[0], offset[1], offset[2]), own.u if own else 0.0)
        targets = {TOOL: tool}
        for name, target in self.stated_targets.items():
            if name != TOOL:
                one = target if target.facings == 1 else replace(target, nest=name)
                targets |= dict.fromkeys(facing_names(name, target.facings), one)
        return targets

    def column(self, axis: str) -> int:
        """Column of an axis in positions (n, k)."""
        return self.axis_names.index(axis)

    def wrapped(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions (n, k) at which errors are known, see ``Axis.wrapped``."""
        if not any(axis.endless for axis in self.axes.values()):
            return q
        columns = zip(self.axis_names, q.T, strict=True)
        return np.stack([self.axes[a].wrapped(own) for a, own in columns], axis=1)

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lower ends of the axis ranges, shape (k,), m and rad."""
        return np.array([self.axes[a].min for a in self.axis_names])

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper ends of the axis ranges, shape (k,), m and rad."""
        return np.array([self.axes[a].max for a in self.axis_names])

    @classmethod
    def from_dict(cls, data: Any, where: str = 'machine') -> Machine:
        """Build a machine from plain data, see ``machine_from_dict``."""
        return machine_from_dict(data, where)

    def to_dict(self) -> dict[str, Any]:
        """Return the description as plain data, in the layout of machine.yaml.

        Values that come from a preset stand beside its name.
        """
        data: dict[str, Any] = {
            'name': self.name,
            'chain': str(self.chain),
            'axes': {a: v.to_dict() for a, v in self.axes.items()},
            'target_offset': [float(v) for v in self.target_offset],
            'tracker': {'u_range': self.tracker.u_range, 'u_angle': self.tracker.u_angle},
        }
        if self.tracker.preset is not None:
            data['tracker']['preset'] = self.tracker.preset
        if self.tracker.link != TABLE:
            data['tracker']['link'] = self.tracker.link
        if self.uncertainty is not None:
            data['uncertainty'] = dict(self.uncertainty.values)
            if self.uncertainty.preset is not None:
                data['uncertainty']['preset'] = self.uncertainty.preset
        if self.limits is not None:
            data['limits'] = dict(self.limits.values)
        for key in ('instrument', 'conditions', 'certificate'):
            if getattr(self.stated, key):
                data[key] = dict(getattr(self.stated, key))
        if self.signals:
            data['signals'] = {s.wanted: s.to_dict() for s in self.signals}
        if self.stated_targets:
            data['targets'] = {n: t.to_dict() for n, t in self.stated_targets.items()}
        if surroundings := self.surroundings.to_dict():
            data['surroundings'] = surroundings
        return data


def facing_names(nest: str, facings: int) -> list[str]:
    """Names of the facings of a reflector as targets; the first one has that of its nest."""
    return [nest, *(f'{nest}-facing-{k}' for k in range(2, facings + 1))]


def machine_from_dict(data: Any, where: str = 'machine') -> Machine:
    """Build a machine from plain data.

    Parameters
    ----------
    data : mapping
        Layout of machine.yaml.
    where : str
        Named in messages, usually the file.

    Raises
    ------
    ConfigError
        Names the key, what it holds and what was expected.
    """
    top = Fields(data, where, KEYS)
    name = top.line('name')
    stated = top.text('chain')
    try:
        chain = Chain.parse(stated)
    except ConfigError as error:
        raise ConfigError(f'{where}: {error}') from None
    axes_fields = top.mapping('axes')
    axes = {}
    for label in chain.axis_names:
        fields = axes_fields.mapping(label)
        axes[label] = _rotary_axis(fields) if label in ROTARY else _axis(fields)
        fields.done()
    for label in axes_fields.keys:
        if label in LETTERS:
            axes_fields.fail(label, f'is not in the chain {chain}')
    axes_fields.done()
    offset = np.array(top.vector('target_offset', 3))
    if np.max(np.abs(offset)) > 10:
        top.fail(
            'target_offset',
            f'{offset.tolist()} m is not a plausible tool length; unit is m, not mm',
        )
    spec = _tracker(top.mapping('tracker'))
    declared = None
    if top.has('uncertainty'):
        declared = declared_from_fields(top.mapping('uncertainty'), spec.preset)
    elif spec.preset is not None:
        declared = declared_from_fields(Fields({}, where), spec.preset)
    limits = None
    if top.has('limits'):
        names = (*chain.motions, *chain.squareness, *chain.location)
        limits = limits_from_fields(top.mapping('limits'), names)
    instrument, conditions, certificate = (
        top.mapping(key) if top.has(key) else Fields({}, where)
        for key in ('instrument', 'conditions', 'certificate')
    )
    circumstances = circumstances_from_fields(instrument, conditions, certificate)
    signals: tuple[SignalSpec, ...] = ()
    if top.has('signals'):
        section = top.mapping('signals')
        signals = signals_from_fields(section, section.keys)
    targets = _targets(top.mapping('targets'), offset) if top.has('targets') else {}
    if chain.location and declared is not None:
        declared, targets = _with_stated_offset(declared, targets, data, offset)
    about = Surroundings()
    if top.has('surroundings'):
        about = surroundings_from_fields(top.mapping('surroundings'))
    top.done(known=KEYS)
    return Machine(
        name, chain, axes, offset, spec, declared, limits, circumstances, signals,
        stated_targets=targets, surroundings=about,
    )  # fmt: skip


def _targets(fields: Fields, offset: NDArray[np.float64]) -> dict[str, Target]:
    """Places of reflectors; ``tool`` states its uncertainty alone."""
    targets: dict[str, Target] = {}
    for name in fields.keys:
        own = fields.mapping(name)
        link = own.text('link') if own.has('link') or name != TOOL else SPINDLE
        if link not in (TABLE, SPINDLE):
            own.fail(
                'link', f"expected 'w' (on the table) or 't' (on the tool side), got '{link}'"
            )
        place = own.vector('place', 3) if own.has('place') or name != TOOL else offset.tolist()
        if max(map(abs, place)) > 10:
            own.fail('place', f'{place} m lies outside any machine; unit is m, not mm')
        if name == TOOL and (link != SPINDLE or not np.allclose(place, offset, atol=1e-9)):
            own.fail('place', "the target 'tool' is at target_offset on the tool side")
        usual = 0.0 if name == TOOL else USUAL_U[link]
        u = own.number('u', low=0.0, high=0.05, unit='m', closed=True) if own.has('u') else usual
        facings, u_facing = _facings(own, link, u)
        own.done(known=('link', 'place', 'u', 'facings', 'u_facing'))
        targets[name] = Target(link, (place[0], place[1], place[2]), u, facings, u_facing)
        for other in facing_names(name, facings)[1:]:
            if other in fields.keys:
                own.fail('facings', f"'{other}' is stated as a target of its own")
    return targets


def _facings(own: Fields, link: str, u: float) -> tuple[int, float]:
    """How often a reflector on the table is turned in its nest, and how well its centre stays."""
    if not own.has('facings'):
        if own.has('u_facing'):
            own.fail('u_facing', 'goes with facings, which is missing')
        return 1, 0.0
    count = own.number('facings', low=1.0, high=MOST_FACINGS, unit='facings', closed=True)
    if count != int(count):
        own.fail('facings', f'expected a whole number, got {count:g}')
    if link != TABLE:
        own.fail('facings', 'of a reflector on the table (link: w) alone')
    if u == 0.0:
        own.fail('facings', 'goes with u above 0: turning a reflector moves its centre')
    usual = USUAL_U_FACING
    stated = own.has('u_facing')
    u_facing = own.number('u_facing', low=1e-9, high=1e-3, unit='m') if stated else usual
    return int(count), u_facing if count > 1 else 0.0


def _with_stated_offset(
    declared: DeclaredUncertainty,
    targets: dict[str, Target],
    data: Any,
    offset: NDArray[np.float64],
) -> tuple[DeclaredUncertainty, dict[str, Target]]:
    """Uncertainty of ``target_offset`` as that of the place of ``tool``, unless it has its own.

    With rotary axes the place of the reflector is solved for; what a preset assumes would leave
    nothing known of the lines of the axes.
    """
    values = dict(declared.values)
    u = values.pop(TARGET_OFFSET, 0.0)
    own = data.get('targets') or {}
    if TARGET_OFFSET in data.get('uncertainty', {}) and 'u' not in (own.get(TOOL) or {}):
        x, y, z = offset.tolist()
        targets = {**targets, TOOL: Target(SPINDLE, (x, y, z), u)}
    return replace(declared, values=values), targets


def _tracker(fields: Fields) -> TrackerSpec:
    preset = fields.text('preset') if fields.has('preset') else None
    values: dict[str, float] = {}
    if preset is not None:
        values.update(chosen(TRACKERS, preset, f'{fields.where}: preset').values)
    for key, unit in (('u_range', 'm'), ('u_angle', 'rad')):
        if preset is None or fields.has(key):
            values[key] = fields.number(key, low=0.0, high=1e-2, unit=unit)
    link = fields.text('link') if fields.has('link') else TABLE
    if link not in (TABLE, BED):
        fields.fail('link', f"expected 'w' (on the table) or 'b' (on the bed), got '{link}'")
    fields.done(known=('preset', 'u_range', 'u_angle', 'link'))
    return TrackerSpec(values['u_range'], values['u_angle'], preset, link)


def _rotary_axis(fields: Fields) -> Axis:
    kind = fields.text('kind')
    if kind != 'rotary':
        fields.fail('kind', f"must be 'rotary' for this letter, got '{kind}'")
    low, high = (_angle(fields, key) for key in ('min', 'max'))
    if not high > low:
        fields.fail('max', f'{high} rad is not above min = {low} rad; the range is empty')
    pitch = fields.number('table_pitch', low=0.0, high=LARGEST_ANGLE, unit='rad')
    if pitch > high - low or math.ceil((high - low) / pitch) > 1000:
        asked = '; is it in degrees?' if math.radians(pitch) <= high - low else ''
        fields.fail('table_pitch', f'{pitch} rad does not suit a range of {high - low} rad{asked}')
    direction = np.array(fields.vector('direction', 3))
    size = float(np.linalg.norm(direction))
    if size < 1e-9:
        fields.fail('direction', 'is zero; expected a vector along the axis')
    centre = fields.vector('centre', 3)
    if max(map(abs, centre)) > FURTHEST_CENTRE:
        fields.fail('centre', f'{centre} m lies outside any machine; is it in mm?')
    endless = fields.take('endless') if fields.has('endless') else False
    if not isinstance(endless, bool):
        fields.fail('endless', f'expected true or false, got {endless!r}')
    if endless and abs(high - low - FULL_TURN) > 1e-3 * FULL_TURN:
        fields.fail('max', f'of an endless axis a full turn above min, {low + FULL_TURN:.6g}')
    fields.done(known=('kind', 'min', 'max', 'table_pitch', 'direction', 'centre', 'endless'))
    x, y, z = (float(v) for v in direction / size)
    return Axis(low, high, pitch, (x, y, z), (centre[0], centre[1], centre[2]), endless)


def _angle(fields: Fields, key: str) -> float:
    """An end of the range of a rotary axis, rad."""
    value = fields.number(key, low=-1e5, high=1e5, unit='rad', closed=True)
    if abs(value) > 8 * FULL_TURN or (abs(value) >= 15 and value % 5 == 0):
        fields.fail(key, f'{value:g} rad is {abs(value) / FULL_TURN:.1f} turns; is it in degrees? '
                         f'Write {math.radians(value):.6g} rad')  # fmt: skip
    return value


def _axis(fields: Fields) -> Axis:
    if fields.has('kind') and (kind := fields.text('kind')) != 'linear':
        fields.fail('kind', f"must be 'linear' for X, Y and Z, got '{kind}'")
    low = fields.number('min', low=-100.0, high=100.0, unit='m', closed=True)
    high = fields.number('max', low=-100.0, high=100.0, unit='m', closed=True)
    if not high > low:
        fields.fail('max', f'{high} m is not above min = {low} m; the range is empty')
    pitch = fields.number('table_pitch', low=0.0, high=100.0, unit='m')
    if pitch > high - low or math.ceil((high - low) / pitch) > 1000:
        asked = '; is it in mm?' if low + 1e-3 * pitch <= high < low + pitch else ''
        fields.fail('table_pitch', f'{pitch} m does not suit a range of {high - low} m{asked}')
    return Axis(low, high, pitch)


def load_machine(path: str | Path) -> Machine:
    """Read a machine.yaml.

    Raises
    ------
    ConfigError
        Names the file and the key that is wrong.

    Examples
    --------
    >>> machine = otf_core.load_machine('bags/y-carries-the-table/machine.yaml')
    >>> str(machine.chain), machine.axes['X'].max, machine.lower.tolist()
    ('w-Y-b-X-Z-t', 0.15, [-0.15, -0.1, -0.25])
    """
    if Path(path).is_dir() or Path(path).suffix in ('.mcap', '.db3'):
        what = 'a folder' if Path(path).is_dir() else 'a recording'
        raise ConfigError(
            f'{path}: cannot be read as machine.yaml, it is {what}; is that the bag?'
        )
    data = read_yaml_bytes(path)
    machine = machine_from_dict(parse_yaml(data, path), str(path))
    return replace(machine, file_sha256=hashlib.sha256(data).hexdigest())

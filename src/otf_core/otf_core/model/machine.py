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
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError
from otf_core.files.strict_yaml import Fields, parse_yaml, read_yaml_bytes
from otf_core.model.circumstances import Circumstances, circumstances_from_fields
from otf_core.model.declared import DeclaredUncertainty, declared_from_fields
from otf_core.model.declared_signals import SignalSpec, signals_from_fields
from otf_core.model.limits import Limits, limits_from_fields
from otf_core.model.presets import TRACKERS, chosen

AXES = ('X', 'Y', 'Z')
"""What axes of machines are called, in the order of the columns of positions.

For this room alone: all others ask the machine for its own (``axis_names``); the directions of
space are ``frames.XYZ``.
"""

KEYS = (
    'name', 'chain', 'axes', 'target_offset', 'tracker', 'uncertainty', 'limits', 'instrument',
    'conditions', 'certificate', 'signals',
)  # fmt: skip
"""Of machine.yaml; all from ``uncertainty`` on are optional."""


@dataclass(frozen=True)
class Axis:
    """Travel of one linear axis: ``min`` and ``max`` in m, nominal node spacing in m."""

    min: float
    max: float
    table_pitch: float


@dataclass(frozen=True)
class TrackerSpec:
    """Specified standard uncertainties: ``u_range`` in m along the beam, ``u_angle`` in rad.

    ``preset`` names the class of tracker that what is not given comes from.
    """

    u_range: float
    u_angle: float
    preset: str | None = None


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
        axes = sorted(p for p in inner if p != 'b')
        if parts[0] != 'w' or parts[-1] != 't' or inner.count('b') != 1 or axes != list(AXES):
            raise ConfigError(
                f"chain: '{text}' is no kinematic chain; write w, the axes X, Y, Z once each and "
                f"the base b between them, then t, as in 'w-Y-b-X-Z-t'"
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
        return tuple(a for a in AXES if a in own)

    def lever_axes(self, axis: str) -> tuple[str, ...]:
        """Axes whose travel is part of the lever arm L of an axis (docs/conventions.md)."""
        if axis in self.target_side:
            return self.target_side[self.target_side.index(axis) + 1 :]
        return self.table_side[self.table_side.index(axis) :] + self.target_side


@dataclass(frozen=True)
class Machine:
    """One machine with three linear axes and the tracker on its table.

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

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Its axes, in the order of the columns of positions."""
        return self.chain.axis_names

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lower ends of the axis ranges, shape (3,), m."""
        return np.array([self.axes[a].min for a in self.axis_names])

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper ends of the axis ranges, shape (3,), m."""
        return np.array([self.axes[a].max for a in self.axis_names])

    def to_dict(self) -> dict[str, Any]:
        """Return the description as plain data, in the layout of machine.yaml.

        Values that come from a preset stand beside its name.
        """
        data: dict[str, Any] = {
            'name': self.name,
            'chain': str(self.chain),
            'axes': {
                a: {'min': v.min, 'max': v.max, 'table_pitch': v.table_pitch}
                for a, v in self.axes.items()
            },
            'target_offset': [float(v) for v in self.target_offset],
            'tracker': {'u_range': self.tracker.u_range, 'u_angle': self.tracker.u_angle},
        }
        if self.tracker.preset is not None:
            data['tracker']['preset'] = self.tracker.preset
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
        return data


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
    for label in AXES:
        fields = axes_fields.mapping(label)
        axes[label] = _axis(fields)
        fields.done()
    axes_fields.done()
    offset = np.array(top.vector('target_offset', 3))
    if np.max(np.abs(offset)) > 10:
        top.fail('target_offset', f'{offset.tolist()} m is no length of a tool; unit is m, not mm')
    spec = _tracker(top.mapping('tracker'))
    declared = None
    if top.has('uncertainty'):
        declared = declared_from_fields(top.mapping('uncertainty'), spec.preset)
    elif spec.preset is not None:
        declared = declared_from_fields(Fields({}, where), spec.preset)
    limits = limits_from_fields(top.mapping('limits')) if top.has('limits') else None
    instrument, conditions, certificate = (
        top.mapping(key) if top.has(key) else Fields({}, where)
        for key in ('instrument', 'conditions', 'certificate')
    )
    circumstances = circumstances_from_fields(instrument, conditions, certificate)
    signals: tuple[SignalSpec, ...] = ()
    if top.has('signals'):
        section = top.mapping('signals')
        signals = signals_from_fields(section, section.keys)
    top.done(known=KEYS)
    return Machine(name, chain, axes, offset, spec, declared, limits, circumstances, signals)


def _tracker(fields: Fields) -> TrackerSpec:
    preset = fields.text('preset') if fields.has('preset') else None
    values: dict[str, float] = {}
    if preset is not None:
        values.update(chosen(TRACKERS, preset, f'{fields.where}: preset').values)
    for key, unit in (('u_range', 'm'), ('u_angle', 'rad')):
        if preset is None or fields.has(key):
            values[key] = fields.number(key, low=0.0, high=1e-2, unit=unit)
    fields.done(known=('preset', 'u_range', 'u_angle'))
    return TrackerSpec(values['u_range'], values['u_angle'], preset)


def _axis(fields: Fields) -> Axis:
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

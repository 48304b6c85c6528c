# SPDX-License-Identifier: Apache-2.0
"""Files in YAML: machine.yaml and effects.yaml."""

from __future__ import annotations

from pathlib import Path

from otf_core.errors import ConfigError
from otf_core.files.strict_yaml import read_yaml
from otf_core.info.kind import Explained, Kind
from otf_core.model.machine import load_machine

YAML = ('.yaml', '.yml')


def _holds(path: Path, kind: type) -> bool:
    if path.suffix.lower() not in YAML or not path.is_file():
        return False
    try:
        return isinstance(read_yaml(path), kind)
    except ConfigError:
        return kind is dict  # whoever reads it as machine.yaml says what is wrong


def _machine(path: Path) -> Explained:
    machine = load_machine(path)
    level = 1e6 * machine.tracker.u_range, 1e6 * machine.tracker.u_angle
    rows = [('machine', f'{machine.name}, chain {machine.chain}')]
    for name in machine.axis_names:
        axis = machine.axes[name]
        rows.append((
            f'axis {name}', f'{1e3 * axis.min:g} to {1e3 * axis.max:g} mm, a node every '
            f'{1e3 * axis.table_pitch:g} mm',
        ))  # fmt: skip
    offset = ', '.join(f'{1e3 * v:g}' for v in machine.target_offset)
    rows += [
        ('target', f'offset ({offset}) mm'),
        ('tracker', f'{level[0]:g} um along, {level[1]:g} urad across the beam'),
        ('uncertainty', 'declared' if machine.uncertainty else
         'nothing declared but the noise of the tracker: u will be too small'),
    ]  # fmt: skip
    return Explained(tuple(rows), machine.to_dict())


def _effects(path: Path) -> Explained:
    data = read_yaml(path)
    rows = []
    for entry in data:
        named = entry if isinstance(entry, dict) else {}
        values = named.get('parameters') or {}
        shown = ', '.join(f'{k} = {v}' for k, v in values.items())
        rows.append((str(named.get('effect', '?')), shown or 'no parameters'))
    return Explained(tuple(rows), {'effects': data})


MACHINE = Kind(
    'machine description',
    'axes, chain, target and tracker of a machine; every verb with --machine reads it',
    lambda path: _holds(path, dict),
    _machine,
)
EFFECTS = Kind(
    'effects',
    'effects with their parameters; otf simulate --effects and calibrate --effects read it',
    lambda path: _holds(path, list),
    _effects,
)

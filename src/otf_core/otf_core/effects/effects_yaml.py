# SPDX-License-Identifier: Apache-2.0
"""effects.yaml: a list of effects with their parameters in SI units.

- effect: backlash
  parameters: {B_X: 5.0e-06}
  units: {B_X: m}            # optional; checked where it stands

Free forms and empirical effects: see ``free_yaml``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from otf_core.effects import EVERY, AppliedEffect, Effect, catalogue
from otf_core.effects.empirical import EMPIRICAL, Empirical, OwnCause
from otf_core.effects.free_form import FreeForm
from otf_core.effects.free_yaml import FREE, empirical_of, free_entry, free_form_of
from otf_core.effects.state import probe_state
from otf_core.errors import ConfigError
from otf_core.files.message_text import shortened
from otf_core.files.strict_yaml import Fields, read_yaml, value_text
from otf_core.files.writing import write_text
from otf_core.model.machine import Machine

FORMULA = 'formula'


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigError(f'{where}: expected a plain number in SI units, got {value_text(value)}')
    try:
        number = float(value)
    except OverflowError:
        raise ConfigError(f'{where}: the number is too large') from None
    if not math.isfinite(number):
        raise ConfigError(f'{where}: expected a plain number in SI units, got {number}')
    return number


def _mapping(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ConfigError(f'{where}: expected names and values, got {value_text(value)}')
    return {str(k): v for k, v in value.items()}


def _entry(data: Any, where: str, machine: Machine) -> AppliedEffect:
    fields = Fields(data, where)
    name = fields.text('effect')
    if name == EMPIRICAL:
        return empirical_of(fields, machine)
    offered = catalogue(machine)
    if name not in offered:
        known = ', '.join((*offered, EMPIRICAL))
        fields.fail('effect', f'{value_text(name)} is unknown; possible: {known}')
    given = _mapping(fields.take('parameters'), f'{where}: {name}: parameters')
    effect, where = _form(name, fields, machine, list(given)), f'{where}: {name}'
    parameters = {k: _number(v, f'{where}: {shortened(k)}') for k, v in given.items()}
    stated = _mapping(fields.take('units'), f'{where}: units') if 'units' in data else {}
    fields.done()
    try:
        units = effect.units(probe_state(machine), parameters)
    except ConfigError as error:
        raise ConfigError(f'{where.removesuffix(name)}{error}') from None
    for key, unit in stated.items():
        if key not in units:
            raise ConfigError(f'{where}: units: {shortened(key)}: not among the parameters')
        if unit != units[key]:
            raise ConfigError(
                f"{where}: units: {key}: {value_text(unit)}; its unit is '{units[key]}'"
            )
    return AppliedEffect(effect, parameters)


def _form(name: str, fields: Fields, machine: Machine, given: Sequence[str]) -> Effect:
    """The formula of an effect, or its free form where the entry says so."""
    form = fields.text('form') if fields.has('form') else FORMULA
    if form not in (FORMULA, FREE):
        fields.fail('form', f'{value_text(form)} is unknown; possible: {FORMULA}, {FREE}')
    return free_form_of(name, fields, machine, given) if form == FREE else EVERY[name]


def effects_from_data(data: Any, where: str, machine: Machine) -> tuple[AppliedEffect, ...]:
    """Build effects from plain data in the layout of effects.yaml.

    Parameters
    ----------
    where : str
        Named in messages, usually the file.
    machine : Machine
        Some parameter names depend on its tables.

    Raises
    ------
    ConfigError
        Names the entry, the key and what is possible.
    """
    if not isinstance(data, list):
        raise ConfigError(f'{where}: expected a list of effects, got {type(data).__name__}')
    return tuple(
        _entry(entry, f'{where}: entry {number}', machine)
        for number, entry in enumerate(data, start=1)
    )


def read_effects(path: str | Path, machine: Machine) -> tuple[AppliedEffect, ...]:
    """Read an effects.yaml; ConfigError names the file, the entry and the key that is wrong."""
    return effects_from_data(read_yaml(path), str(path), machine)


def read_own_causes(folder: str | Path, machine: Machine) -> tuple[OwnCause, ...]:
    """Read causes of one's own: every named empirical effect of the .yaml files of a folder.

    Raises
    ------
    ConfigError
        If the folder holds none, one has no name or the name of another, or a file is wrong.
    """
    causes: dict[str, OwnCause] = {}
    for file in sorted(Path(folder).glob('*.yaml')):
        for one in read_effects(file, machine):
            name = one.effect.name
            if not isinstance(one.effect, FreeForm) or not isinstance(
                one.effect.parent, Empirical
            ):
                raise ConfigError(
                    f'{file}: {name}: only empirical effects can be named causes of your own'
                )
            if name == EMPIRICAL:
                raise ConfigError(f'{file}: an empirical effect without a name; add name: ...')
            if name in causes or name in EVERY:
                raise ConfigError(f'{file}: {name}: this name is taken; choose another one')
            causes[name] = OwnCause(one)
    if not causes:
        raise ConfigError(f'{folder}: no .yaml file with an empirical effect in this folder')
    return tuple(causes.values())


def effects_to_data(effects: Sequence[AppliedEffect], machine: Machine) -> list[dict[str, Any]]:
    """Return effects as plain data in the layout of effects.yaml, units included."""
    probe = probe_state(machine)

    def entry(one: AppliedEffect) -> dict[str, Any]:
        if isinstance(one.effect, OwnCause):
            one = one.effect.sized(one.parameters)
        if isinstance(one.effect, FreeForm):
            return free_entry(one, machine)
        return {
            'effect': one.effect.name,
            'parameters': {k: float(v) for k, v in one.parameters.items()},
            'units': one.effect.units(probe, one.parameters),
        }

    return [entry(one) for one in effects]


def write_effects(path: str | Path, effects: Sequence[AppliedEffect], machine: Machine) -> None:
    """Write an effects.yaml; reading it gives the same numbers to the last digit."""
    data = effects_to_data(effects, machine)
    write_text(path, yaml.safe_dump(data, sort_keys=False, default_flow_style=None))

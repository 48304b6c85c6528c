# SPDX-License-Identifier: Apache-2.0
"""effects.yaml: a list of effects with their parameters in SI units.

- effect: backlash
  parameters: {B_X: 5.0e-06}
  units: {B_X: m}            # optional; checked where it stands
- effect: backlash
  form: free
  inputs: {time: [0.0, 300.0]}        # range of every input
  parameters: {B_X_0: 5.0e-06, B_X_1: 2.0e-06}
- effect: empirical
  name: sinking_corner                # may be left out
  acts_as: direction                  # vector, direction, rigid_tracker or rigid_table
  direction: [0.0, 0.0, 1.0]          # of acts_as direction
  nodes: {time: [0.0, 150.0, 300.0]}  # of every input; the ends are its range
  table: {along: [0.0, 1.0e-06, 4.0e-06]}
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from otf_core.effects import EVERY, AppliedEffect, Effect, catalogue
from otf_core.effects.action import ACTING, DIRECTION, Acting, Along, acting_name
from otf_core.effects.free import Free, declare_switching, follower
from otf_core.effects.free_form import (
    EMPIRICAL,
    Empirical,
    FreeForm,
    OwnCause,
    node_table,
    of_table,
)
from otf_core.effects.inputs import SIGNAL, Span, Switching, known_input
from otf_core.effects.state import probe_state
from otf_core.effects.terms import State
from otf_core.errors import ConfigError
from otf_core.files.message_text import shortened
from otf_core.files.strict_yaml import Fields, read_yaml, value_text
from otf_core.files.writing import write_text
from otf_core.model.machine import Machine

FORMULA, FREE = 'formula', 'free'


def _numbers(value: Any, fields: Fields, key: str) -> list[float]:
    values = value if isinstance(value, list) else [value]
    plain = [isinstance(v, (int, float)) and not isinstance(v, bool) for v in values]
    if not values or not all(plain) or not np.all(np.isfinite(np.array(values, dtype=float))):
        fields.fail(key, 'expected a list of plain numbers in SI units')
    return [float(v) for v in values]


def _ranges(fields: Fields, key: str) -> dict[str, list[float]]:
    value = fields.take(key)
    if not isinstance(value, dict) or not value:
        fields.fail(key, 'expected names of inputs and lists of numbers')
    ranges = {}
    for name, own in value.items():
        if not known_input(str(name)):
            fields.fail(key, f'input {value_text(str(name))} is unknown')
        ranges[str(name)] = _numbers(own, fields, f'{key}: {name}')
        if ranges[str(name)] != sorted(ranges[str(name)]):
            fields.fail(f'{key}: {name}', 'the numbers must be ascending')
    return ranges


def free_form_of(name: str, fields: Fields, machine: Machine, given: Sequence[str]) -> Effect:
    """Read which free form of an effect of the catalogue is meant, with the ranges of its inputs.

    Of several ways to act it is the first that has the ``given`` coefficients.

    Raises
    ------
    ConfigError
        If the effect has no free form of these inputs.
    """
    effect, ranges = EVERY[name], _ranges(fields, 'inputs')
    spans: dict[str, Span] = {}
    for key, own in ranges.items():
        if len(own) != 2:
            fields.fail(f'inputs: {key}', 'expected the smallest and the largest value')
        spans[key] = (own[0], own[1])
    ways = _ways(effect, tuple(spans))
    probe, known = probe_state(machine), []
    for free in () if ways else effect.free:
        bound = FreeForm.bound(effect, free, [probe])
        known.append(', '.join(bound.spans))
        if set(bound.spans) == set(spans):
            ways.append(free)
    if not ways:
        listed = '; '.join(dict.fromkeys(known)) or 'none'
        fields.fail('inputs', f'{name} has no free form of these inputs; possible: {listed}')
    forms = [FreeForm(effect, way, spans) for way in ways]
    return next((f for f in forms if _takes(f, probe, given)), forms[0])


def _takes(effect: Effect, probe: State, given: Sequence[str]) -> bool:
    """Whether an effect has all given parameters."""
    try:
        return bool(effect.units(probe, dict.fromkeys(given, 1.0)))
    except ConfigError:
        return False


def _ways(effect: Effect, inputs: Sequence[str]) -> list[Free]:
    """Forms that follow a signal, or something that switches, simple ones first."""
    name = inputs[0] if len(inputs) == 1 else ''
    if name.startswith(SIGNAL):
        return [follower(acts, name, order) for order in (1, 2) for acts in effect.follows]
    switching = Switching.of(name)
    orders = (1, len(switching.moments)) if switching else ()
    return [
        declare_switching(acts, switching, order)
        for order in orders for acts in effect.switches if switching
    ]  # fmt: skip


def empirical_of(fields: Fields, machine: Machine) -> AppliedEffect:
    """Read an empirical effect; what is wrong is a ConfigError that names the key."""
    name = fields.text('name') if fields.has('name') else EMPIRICAL
    acts = _acts_of(fields)
    nodes, table = _ranges(fields, 'nodes'), fields.take('table')
    if switching := next((n for n in nodes if Switching.of(n)), None):
        fields.fail('nodes', f'{value_text(switching)} is not an input of a table; write time')
    fields.done()
    if not isinstance(table, dict) or not table:
        fields.fail('table', 'expected the values of each direction or rotation')
    known = acts(probe_state(machine), {}).names
    for term in table:
        if term not in known:
            fields.fail(
                'table', f'{value_text(str(term))} is unknown; possible: {", ".join(known)}'
            )
    shape = tuple(len(v) for v in nodes.values())
    values = {}
    for term, own in table.items():
        try:
            values[str(term)] = np.array(own, dtype=float)
        except (TypeError, ValueError):
            fields.fail(f'table: {term}', 'expected numbers')
        if values[str(term)].shape != shape or not np.all(np.isfinite(values[str(term)])):
            wanted = ' x '.join(map(str, shape))
            fields.fail(f'table: {term}', f'expected {wanted} finite numbers, as many as nodes')
    try:
        return of_table(name, acts, nodes, values)
    except ValueError as error:
        fields.fail('nodes', str(error))


def _acts_of(fields: Fields) -> Acting:
    acts_as = fields.text('acts_as')
    if acts_as == DIRECTION:
        direction = _numbers(fields.take('direction'), fields, 'direction')
        size = float(np.linalg.norm(direction))
        if len(direction) != 3 or not size > 0.0:
            fields.fail('direction', 'expected three numbers, not all zero')
        x, y, z = (v / size for v in direction)
        return Along((x, y, z))
    if acts_as not in ACTING:
        known = ', '.join((*ACTING, DIRECTION))
        fields.fail('acts_as', f'{value_text(acts_as)} is unknown; possible: {known}')
    return ACTING[acts_as]


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
        effect = one.effect
        if isinstance(effect, FreeForm) and effect.is_structure:
            return _table_entry(one, effect)
        data: dict[str, Any] = {'effect': effect.name}
        if isinstance(effect, FreeForm):
            data |= {'form': FREE, 'inputs': {n: list(span) for n, span in effect.spans.items()}}
        parameters = {k: float(v) for k, v in one.parameters.items()}
        return {**data, 'parameters': parameters, 'units': effect.units(probe, parameters)}

    return [entry(one) for one in effects]


def _table_entry(one: AppliedEffect, effect: FreeForm) -> dict[str, Any]:
    nodes, values = node_table(one)
    acts = effect.form.acts
    return {
        'effect': EMPIRICAL,
        **({} if effect.name == EMPIRICAL else {'name': effect.name}),
        'acts_as': acting_name(acts),
        **({'direction': list(acts.direction)} if isinstance(acts, Along) else {}),
        'nodes': nodes,
        'table': {term: own.tolist() for term, own in values.items()},
    }


def write_effects(path: str | Path, effects: Sequence[AppliedEffect], machine: Machine) -> None:
    """Write an effects.yaml; reading it gives the same numbers to the last digit."""
    data = effects_to_data(effects, machine)
    write_text(path, yaml.safe_dump(data, sort_keys=False, default_flow_style=None))

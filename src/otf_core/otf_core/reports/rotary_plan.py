# SPDX-License-Identifier: Apache-2.0
"""What ``otf plan`` writes of a machine with rotary axes: plan, path, forecast.

plan.json (``otf-rotary-plan/1``), SI units: machine, place of the tracker in the frame of its
link, parts with target, axis positions at the corners, dwell and duration, and the forecast.
path.csv (``target,x,y,z,a,c``) and path.mcap (``/planner/axes`` messages) hold the parts alone.
For a dialect one NC program per part with TCP off, and verify.csv with its program, TCP on.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.bags.bag import write_axis_paths
from otf_core.config import PlannerConfig
from otf_core.files.writing import write_text
from otf_core.inputs.path_file import ROTARY_SCHEMA
from otf_core.model.machine import BED, TABLE, Machine
from otf_core.model.motions import unit_of
from otf_core.planning.axis_programs import (
    part_program,
    verification_part,
    verification_program,
)
from otf_core.planning.line_of_sight import (
    ENOUGH,
    HAND_TURN,
    LEAST_OPEN,
    SightShare,
    facings_needed,
)
from otf_core.planning.nc.dialect import Dialect
from otf_core.planning.part_choice import work_by_hand
from otf_core.planning.rotary_forecast import RotaryForecast, duration_of
from otf_core.planning.rotary_paths import HAND_MOVE, PlannedPart
from otf_core.reports.page import Heading, Section, State, Table, micro, micro_unit, page_html

UNKNOWN_VECTORS = 1e-4
"""m; mean uncertainty of error vectors from which they are not determined."""


@dataclass(frozen=True)
class RotaryPlan:
    """A plan with its forecast.

    Attributes
    ----------
    config : PlannerConfig
        Feed and standstills of the parts.
    place : ndarray, shape (3,), m
        Beam origin of the tracker in the frame of its link.
    sight : mapping of target to SightShare
        Of targets that rotary axes turn before the tracker.
    near : sequence of str
        Where a reflector comes near to something.
    """

    machine: Machine
    parts: Sequence[PlannedPart]
    config: PlannerConfig
    place: Array
    forecast: RotaryForecast
    sight: Mapping[str, SightShare]
    near: Sequence[str] = ()

    @property
    def turns(self) -> int:
        """How often a reflector is turned by hand to its next facing."""
        turning = [self.machine.column(a) for a in self.machine.rotary_names]
        driven = {
            part.path.target
            for part in self.parts
            if np.ptp(part.path.positions[:, turning], axis=0).any()
        }
        planned = work_by_hand(self.machine, self.parts)[1]
        return planned + sum(
            facings_needed(s) - 1
            for name, s in self.sight.items()
            if name in driven and not self.machine.targets[name].nest
        )

    @property
    def durations(self) -> list[float]:
        """Driving time of every part, s."""
        return [duration_of(self.machine, part, self.config) for part in self.parts]

    @property
    def by_hand(self) -> float:
        """Time for moves and turns of the reflector by hand, s."""
        return HAND_MOVE * work_by_hand(self.machine, self.parts)[0] + HAND_TURN * self.turns


def plan_to_dict(plan: RotaryPlan, about: Mapping[str, Any]) -> dict[str, Any]:
    """Return a plan as plain data in the layout of plan.json."""
    forecast = plan.forecast
    return {
        'schema': ROTARY_SCHEMA,
        'machine': plan.machine.to_dict(),
        'tracker': {'link': plan.machine.tracker.link, 'place': plan.place.tolist()},
        'axes': list(plan.machine.axis_names),
        'parts': [
            {
                'target': part.path.target,
                'words': part.words,
                'feed': plan.config.feed,
                'dwell': part.halt(plan.config),
                'end_dwell': plan.config.end_dwell,
                'stops': part.stops,
                'duration': duration,
                'positions': part.path.positions.tolist(),
            }
            for part, duration in zip(plan.parts, plan.durations, strict=True)
        ],
        'sight': {
            name: {
                'half_angle': plan.machine.surroundings.half_angle,
                'open': own.open,
                'facings': list(own.facings),
                'ranges': {a: list(ends) for a, ends in own.ranges.items()},
            }
            for name, own in plan.sight.items()
        },
        'near': list(plan.near),
        'forecast': {
            'duration': forecast.duration,
            'by_hand': plan.by_hand,
            'grid_u': forecast.grid_u,
            'u': {n: {'u': u, 'unit': unit_of(n)} for n, u in forecast.u.items()},
            'hidden': dict(forecast.hidden),
        },
        'provenance': dict(about),
    }


def plan_words(plan: RotaryPlan) -> str:
    """Return the plan in words: parts, what will be seen how well, what not and why."""
    machine, forecast = plan.machine, plan.forecast
    width = max(10, *(len(part.path.target) for part in plan.parts))
    lines = [*_work_words(plan), '']
    for part, duration in zip(plan.parts, plan.durations, strict=True):
        lines.append(f'  {part.path.target:{width}s} {duration / 60:5.1f} min  {part.words}')
    lines += [f'  {sentence}' for sentence in _sight_words(plan)]
    lines += ['', _vector_words(forecast)]
    shown = [n for n in forecast.u if n not in forecast.hidden]
    groups = [list(machine.squareness), list(machine.location)]
    groups += [[str(m) for m in machine.motions if m.axis == a] for a in machine.axis_names]
    for group in groups:
        stated = [f'{n} {1e6 * forecast.u[n]:.2f}' for n in group if n in shown]
        if stated:
            lines.append('  ' + ', '.join(stated))
    if forecast.hidden:
        lines += ['', 'Will not be seen:']
        for why in dict.fromkeys(forecast.hidden.values()):
            names = ', '.join(n for n, own in forecast.hidden.items() if own == why)
            lines.append(f'  {names}: {why}')
    return '\n'.join(lines)


def plan_page(plan: RotaryPlan, date: str) -> str:
    """Return the page; ``date`` is when the plan was made."""
    forecast = plan.forecast
    parts = tuple(
        (part.path.target, f'{duration / 60:.1f}', part.words)
        for part, duration in zip(plan.parts, plan.durations, strict=True)
    )
    errors = tuple(
        (name, micro_unit(unit_of(name)), forecast.hidden.get(name) or micro(u))
        for name, u in forecast.u.items()
    )
    sections = [
        Section('overview', '', (*_work_words(plan), *_sight_words(plan))),
        Section('parts', 'Parts', tables=(Table(('Target', 'Time (min)', 'What'), parts, (1,)),)),
        Section('errors', 'What the parts show', (_vector_words(forecast),),
                tables=(Table(('Error', 'Unit', 'u (k = 1), or why not seen'), errors),)),
    ]  # fmt: skip
    badge = State('all errors shown', 'good')
    if forecast.hidden:
        badge = State(f'{len(forecast.hidden)} errors not shown', 'open')
    name = plan.machine.name
    return page_html(
        Heading(f'Plan for {name}', '', (badge,), running=f'{name}, plan, {date}'), sections
    )


def _work_words(plan: RotaryPlan) -> list[str]:
    """Where the tracker stands, and what driving and moving reflectors by hand takes."""
    machine = plan.machine
    link = 'bed' if machine.tracker.link == BED else 'table'
    at = ', '.join(f'{1e3 * v:.0f}' for v in plan.place)
    moves = work_by_hand(machine, plan.parts)[0]
    return [
        f'{machine.name}, chain {machine.chain}; tracker on the {link} at ({at}) mm',
        f'{plan.forecast.duration / 60:.1f} min of driving; {moves} moves of the reflector by '
        f'hand and {plan.turns} turns to another facing (about {plan.by_hand / 60:.0f} min); the '
        f'tracker stays where it is throughout',
    ]


def _sight_words(plan: RotaryPlan) -> list[str]:
    """How much of every reflector is seen, and what comes near to it."""
    machine, lines = plan.machine, list[str]()
    for name, own in plan.sight.items():
        count = facings_needed(own)
        facings = f'{count} facings of the reflector'
        share = 100 * own.facings[count - 1]
        lines.append(
            f'{name}: seen in {share:.0f} % of the positions of the rotary axes with {facings} '
            f'({np.degrees(machine.surroundings.half_angle):.0f} degrees to each side)'
        )
        if own.facings[-1] < ENOUGH <= own.open:
            lines.append(
                f'{name}: a cat-eye or an active target sees more (surroundings: half_angle in '
                f'machine.yaml)'
            )
        if own.open < LEAST_OPEN:
            lines.append(f'{name}: {_hidden_words(machine, name, own)}')
    return [*lines, *_facing_words(plan), *plan.near]


def _facing_words(plan: RotaryPlan) -> list[str]:
    """What to do where one facing of a reflector on the table does not show enough."""
    targets = plan.machine.targets
    driven = {part.path.target for part in plan.parts}
    lines: list[str] = []
    whole: dict[str, int] = {}
    for name, own in plan.sight.items():
        if targets[name].link != TABLE or facings_needed(own) == 1:
            continue
        facings = [t for t in driven if targets[t].nest == name]
        if facings:
            lines.append(
                f'{name}: {len(facings)} facings planned; turn the reflector to the tracker '
                f'where the part of each begins'
            )
        elif name in driven:
            whole[name] = facings_needed(own)
    if whole:
        lines.append(
            f'{", ".join(whole)}: planned for a reflector that is seen throughout (active '
            f'target); of one that is turned by hand state facings: {max(whole.values())} in '
            f'machine.yaml and plan again'
        )
    return lines


def _vector_words(forecast: RotaryForecast) -> str:
    words = 'Expected standard uncertainty (k = 1)'
    if forecast.grid_u < UNKNOWN_VECTORS:
        words += (
            f' of an error vector: {1e6 * forecast.grid_u:.2f} um on average over the ranges '
            f'driven;'
        )
    return f'{words} of errors (um, urad; root mean square of the nodes):'


def _hidden_words(machine: Machine, name: str, sight: SightShare) -> str:
    what = 'table' if machine.targets[name].link == TABLE else 'spindle'
    ranges = ' or '.join(
        f'{axis} from {np.degrees(low):.0f} to {np.degrees(high):.0f} degrees'
        for axis, (low, high) in sight.ranges.items()
        if high > low and not machine.axes[axis].endless
    )
    words = (
        f'the {what} hides it in {100 * (1 - sight.open):.0f} % of the positions from the best '
        f'place of the tracker'
    )
    return words + (f'; it is never hidden with {ranges}' if ranges else '')


def path_csv(machine: Machine, parts: Sequence[PlannedPart]) -> str:
    """Return the corners of parts, m and rad, as ``simulate --path`` reads them."""
    lines = [','.join(['target', *(a.lower() for a in machine.axis_names)])]
    for part in parts:
        for corner in part.path.positions.tolist():
            lines.append(','.join([part.path.target, *(f'{v:.12g}' for v in corner)]))
    return '\n'.join(lines) + '\n'


def programs_of(plan: RotaryPlan, dialect: Dialect) -> dict[str, str]:
    """Files of the NC programs of a plan: one per part, TCP off, and the verification, TCP on.

    Raises
    ------
    ConfigError
        If the dialect cannot express the plan.
    """
    machine, header = plan.machine, [f'otf plan: machine {plan.machine.name}']
    programs = {
        dialect.file_of(k): part_program(dialect, machine, part, k, plan.config, header)
        for k, part in enumerate(plan.parts, start=1)
    }
    last = verification_part(machine)
    if last is not None:
        number = len(plan.parts) + 1
        text = verification_program(dialect, machine, last, number, header)
        programs |= {dialect.file_of(number): text, 'verify.csv': path_csv(machine, [last])}
    return programs


def write_plan(
    plan: RotaryPlan,
    folder: Path,
    about: Mapping[str, Any],
    dialect: Dialect | None = None,
) -> list[Path]:
    """Write plan.json, path.csv, path.mcap, report.html and programs; return their paths."""
    texts = {} if dialect is None else programs_of(plan, dialect)
    texts |= {
        'plan.json': json.dumps(plan_to_dict(plan, about), indent=1) + '\n',
        'path.csv': path_csv(plan.machine, plan.parts),
        'report.html': plan_page(plan, str(about['written'])),
    }
    for name, text in texts.items():
        write_text(folder / name, text)
    write_axis_paths(folder / 'path.mcap', [part.path for part in plan.parts])
    return [folder / name for name in (*texts, 'path.mcap')]

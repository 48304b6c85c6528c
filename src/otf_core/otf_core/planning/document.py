# SPDX-License-Identifier: Apache-2.0
"""plan.json: a plan, what its forecast assumed and found, and what it does not show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from otf_core.arrays import Array, Flags
from otf_core.documents import Document, optional, stated
from otf_core.inputs.path_file import SCHEMA, Assumed, PlanFile, PlannedPart
from otf_core.model.axis_path import nominal_track
from otf_core.model.machine import BED, TABLE, Machine
from otf_core.model.motions import is_motion, unit_of
from otf_core.noise.noise_model import noise_to_fields
from otf_core.planning.findings import UnseenError
from otf_core.planning.follow_up import TrackerPlace
from otf_core.planning.forecast import Forecast
from otf_core.planning.line_of_sight import ENOUGH, LEAST_OPEN, SightShare, facings_needed
from otf_core.planning.plan_report import PlanReport


@dataclass(frozen=True)
class ForecastError(Document):
    """How well an error would be known."""

    unit: str = stated('m or rad')
    identifiable: bool = stated('false: the path does not show it')
    node_identifiable: Flags = stated('false: it would continue smoothly', shape=('k',))
    u: Array = stated('standard uncertainty by tracker noise alone', 'm or rad', shape=('k',))
    axis: str | None = optional('axis that moves')
    position: Array | None = optional('nodes', 'm or rad', shape=('k',))


@dataclass(frozen=True)
class ForecastGrid(Document):
    """Uncertainty of the error vector over the volume by tracker noise alone."""

    point: Array = stated('axis positions', 'm or rad', shape=('n', 'axes'))
    u: Array = stated('best rigid motion removed', 'm', shape=('n', 3))
    u_in_gauge: Array = stated('in the gauge of the tables', 'm', shape=('n', 3))


@dataclass(frozen=True)
class ForecastBlock(Document):
    """What the path would show."""

    pieces: int = stated('pieces of the path')
    unknowns: int = stated('free unknowns after the gauge')
    rank: int = stated('combinations of them that the path determines')
    holds: str = stated('what the uncertainties contain')
    mean_grid_u: float = stated('mean length of u of the grid', 'm')
    mean_grid_u_in_gauge: float = stated('the same in the gauge of the tables', 'm')
    errors: Mapping[str, ForecastError] = stated('by name')
    grid: ForecastGrid = stated('over the volume')


@dataclass(frozen=True)
class SightEntry(Document):
    """In which share of the positions of the rotary axes a reflector is seen."""

    half_angle: float = stated('of a reflector', 'rad')
    open: float = stated('share in which nothing stands before it')
    facings: tuple[float, ...] = stated('share seen with 1, 2, ... facings')
    ranges: Mapping[str, tuple[float, float]] = stated('in which nothing hides it', 'rad')


@dataclass(frozen=True)
class PlanDocument(PlanFile):
    """A path, its forecast, and what to do with it."""

    file = 'plan.json'

    machine: Machine = stated('machine.yaml')
    how: str = stated('how the path came about')
    length: float = stated('of the tracks of the reflectors', 'm')
    duration: float = stated('of the drive', 's')
    by_hand: float = stated('for moves and turns of the reflector by hand', 's')
    margin: float = stated('least distance from the ends of the linear axes', 'm')
    forecast: ForecastBlock = stated('tracker noise alone')
    systematic: Mapping[str, Any] = stated(
        'u and u_run of the volume with systematic contributions, as the headline of a calibration'
    )
    not_shown: tuple[UnseenError, ...] = stated('errors that the path does not show')
    sight: Mapping[str, SightEntry] = stated('of reflectors that rotary axes turn')
    near: tuple[str, ...] = stated('what comes near to what')
    remarks: tuple[str, ...] = stated('work by hand, sight, what comes near')
    advice: tuple[str, ...] = stated('where the tracker stands best')
    sentences: tuple[str, ...] = stated('what is to be expected after compensation')
    tracker_places: tuple[TrackerPlace, ...] = stated('compared, the best first')
    effects: Mapping[str, Mapping[str, Any]] = stated('sizes from which a diagnosis finds them')
    after: tuple[Mapping[str, Any], ...] = stated('answers to questions of a diagnosis')
    schema: str = stated('otf-plan/2', default=SCHEMA)
    provenance: Mapping[str, Any] = stated('when, from what, by what', factory=dict)


def document_of(report: PlanReport) -> PlanDocument:
    """Return what a plan states."""
    setup, machine = report.setup, report.setup.machine
    return PlanDocument(
        machine=machine,
        how=report.how,
        axes=tuple(machine.axis_names),
        parts=tuple(
            PlannedPart(p.target, p.feed, p.dwell, p.path.positions, p.words, setup.seconds(p))
            for p in report.plan.parts
        ),
        length=plan_length(report),
        duration=report.forecast.duration,
        by_hand=report.by_hand,
        margin=_margin(report),
        assumed=Assumed(
            machine.tracker.link, setup.place, noise_to_fields(setup.noise), setup.config.rate,
            setup.config.acceleration,
        ),
        forecast=_forecast(report.forecast),
        systematic=report.systematic.to_dict(),
        not_shown=report.findings,
        sight={
            name: SightEntry(machine.surroundings.half_angle, **asdict(own))
            for name, own in report.sight.items()
        },
        near=tuple(report.near),
        remarks=(*_work_words(report), *_sight_words(report)),
        advice=report.advice,
        sentences=(report.systematic.expected.expanded_words,
                   report.systematic.expected.forecast_words),
        tracker_places=report.places,
        effects={e['effect']: dict(e) for e in report.effects},
        after=tuple(a.to_dict() for a in report.after),
        provenance=report.provenance,
    )  # fmt: skip


def _forecast(outlook: Forecast) -> ForecastBlock:
    errors = {
        name: ForecastError(
            unit_of(name),
            name not in outlook.not_identifiable,
            outlook.determined[name],
            u,
            *((name[-1], outlook.nodes[name[-1]]) if is_motion(name) else ()),
        )
        for name, u in outlook.u.items()
    }
    return ForecastBlock(
        pieces=sum(len(run.pieces) for run in outlook.runs),
        unknowns=outlook.joint.solution.unknowns,
        rank=outlook.joint.solution.rank,
        holds='noise',
        mean_grid_u=outlook.mean_grid_u,
        mean_grid_u_in_gauge=float(np.linalg.norm(outlook.grid_u, axis=1).mean()),
        errors=errors,
        grid=ForecastGrid(outlook.grid, outlook.grid_u_free, outlook.grid_u),
    )


def plan_length(report: PlanReport) -> float:
    """Length of the tracks of the reflectors, m."""
    paths = [part.path for part in report.plan.parts]
    return sum(nominal_track(report.setup.machine, paths).part_lengths)


def _margin(report: PlanReport) -> float:
    """Least distance of the path from the ends of the linear axes, m."""
    machine, least = report.setup.machine, np.inf
    for part in report.plan.parts:
        for k, axis in enumerate(machine.axes.values()):
            q = part.path.positions[:, k]
            if not axis.rotary:
                least = min(least, float(np.minimum(q - axis.min, axis.max - q).min()))
    return max(least, 0.0) if np.isfinite(least) else 0.0


def _work_words(report: PlanReport) -> list[str]:
    """What driving and moving reflectors by hand takes."""
    if not report.moves + report.turns:
        return []
    link = 'bed' if report.setup.machine.tracker.link == BED else 'table'
    return [
        f'tracker on the {link}; {report.moves} moves of the reflector by hand and {report.turns} '
        f'turns to another facing (about {report.by_hand / 60:.0f} min); the tracker stays where '
        f'it is throughout'
    ]


def _sight_words(report: PlanReport) -> list[str]:
    """How much of every reflector is seen, and what comes near to it."""
    machine, lines = report.setup.machine, list[str]()
    for name, own in report.sight.items():
        count = facings_needed(own)
        lines.append(
            f'{name}: seen in {100 * own.facings[count - 1]:.0f} % of the positions of the rotary '
            f'axes with {count} facings of the reflector '
            f'({np.degrees(machine.surroundings.half_angle):.0f} degrees to each side)'
        )
        if own.facings[-1] < ENOUGH <= own.open:
            lines.append(
                f'{name}: a cat-eye or an active target sees more (surroundings: half_angle in '
                f'machine.yaml)'
            )
        if own.open < LEAST_OPEN:
            lines.append(f'{name}: {_hidden_words(machine, name, own)}')
    return [*lines, *_facing_words(report), *report.near]


def _facing_words(report: PlanReport) -> list[str]:
    """What to do where one facing of a reflector on the table does not show enough."""
    targets = report.setup.machine.targets
    driven = {part.target for part in report.plan.parts}
    lines: list[str] = []
    whole: dict[str, int] = {}
    for name, own in report.sight.items():
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

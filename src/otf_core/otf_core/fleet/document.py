# SPDX-License-Identifier: Apache-2.0
"""fleet.json: how every run of a fleet ended, and its headline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from otf_core.documents import Document, ResultDocument, optional, stated
from otf_core.fleet.fleet import JobResult, listed_results
from otf_core.model.expanded import COVERAGE_FACTOR
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.prediction.absorbed import OffsetBound, offset_words
from otf_core.prediction.calibration_document import LIMIT_NOT_PROVEN, MEASUREMENT_FAILED


@dataclass(frozen=True)
class ScalarHeadline(Document):
    """A squareness or location error."""

    value: float = stated('actual minus nominal', 'm or rad')
    u: float = stated('standard uncertainty with everything that is stated', 'm or rad')
    k: float = stated('coverage factor for 95 %')


@dataclass(frozen=True)
class RunHeadline(Document):
    """What is repeated of an error_tables.json, or of a gap.json."""

    machine: str = stated('name')
    target_offset: tuple[float, ...] | None = optional('target offset', 'm')
    good: bool | None = optional('no quality gate failed')
    limits: str | None = optional('state of the limits')
    error: Mapping[str, float] | None = optional('mean, p95 and max length of errors', 'm')
    u: Mapping[str, float] | None = optional('standard uncertainty of them', 'm')
    u_run: Mapping[str, float] | None = optional('noise and misfit alone', 'm')
    u_of_largest: float | None = optional('of the largest length', 'm')
    k: float | None = optional('coverage factor for 95 %')
    scalars: Mapping[str, ScalarHeadline | None] | None = optional(
        'squareness and location errors; null: not known'
    )
    target_offset_bound: OffsetBound | None = optional(
        'values that hold at one target offset only'
    )
    verdict: str | None = optional('verdict of a diagnosis')
    measured_um: float | None = optional('residual of the run', 'um')
    simulated_um: float | None = optional('residual of its simulation', 'um')
    causes: tuple[str, ...] | None = optional('effects with their axes')


@dataclass(frozen=True)
class FleetDocument(ResultDocument):
    """Runs of a fleet side by side."""

    file = 'fleet.json'

    verb: str = stated('calibrate or diagnose')
    done: int = stated('runs with results')
    failed: int = stated('runs without')
    runs: Mapping[str, JobResult] = stated('how every run ended')
    results: Mapping[str, RunHeadline] = stated('headline of every run that is done')
    warnings: tuple[str, ...] = stated('what is to be minded when runs are compared')
    schema: str = stated('otf-fleet/1', default='otf-fleet/1')

    @property
    def exit_code(self) -> int:
        """0; 5 if limits alone are not proven to be met; 4 if some failed or are not good."""
        exits = {run.exit for run in self.runs.values()} - {0}
        if not exits:
            return 0
        return LIMIT_NOT_PROVEN if exits == {LIMIT_NOT_PROVEN} else MEASUREMENT_FAILED


def fleet_document(verb: str, folder: Path, outcomes: Mapping[str, JobResult]) -> FleetDocument:
    """Return what a fleet states: outcomes, and the headline of every run that is done."""
    headline = _calibration_headline if verb == 'calibrate' else _gap_headline
    results = {n: headline(data) for n, data in listed_results(verb, folder, outcomes)}
    warnings = list[str]()
    if verb == 'calibrate':
        warnings = offset_remarks({n: own.target_offset_bound for n, own in results.items()})
    done = sum(outcome.done for outcome in outcomes.values())
    return FleetDocument(
        verb, done, len(outcomes) - done, dict(outcomes), results, tuple(warnings)
    )


def _calibration_headline(data: Mapping[str, Any]) -> RunHeadline:
    head, hidden = data['headline'], data['not_identifiable']
    entries = {**data.get('squareness', {}), **data.get('location', {})}
    return RunHeadline(
        data['machine']['name'],
        target_offset=tuple(data['machine']['target_offset']),
        good=data['verdicts']['measurement']['good'],
        limits=data['verdicts']['machine']['state'],
        **{key: head[key] for key in ('error', 'u', 'u_run', 'u_of_largest', 'k')},
        scalars={
            n: None if n in hidden
            else ScalarHeadline(own['value'], own['u'], own.get('k') or COVERAGE_FACTOR)
            for n, own in entries.items()
        },
        target_offset_bound=OffsetBound.from_dict(data['target_offset_bound']),
    )  # fmt: skip


def _gap_headline(data: Mapping[str, Any]) -> RunHeadline:
    machines = data.get('provenance', {}).get('machines', [{}])
    return RunHeadline(
        str(machines[0].get('name', '')),
        verdict=data['verdict'],
        measured_um=data['gap']['measured_um'],
        simulated_um=data['gap']['simulated_um'],
        causes=tuple(
            f'{c["effect"]} {" ".join(c.get("axes") or [])}'.strip() for c in data['causes']
        ),
    )


def offset_remarks(bound: Mapping[str, OffsetBound | None]) -> list[str]:
    """What is to be minded where values hold at the target offset of their own run only.

    Parameters
    ----------
    bound : mapping of run to its ``target_offset_bound``
    """
    contains = [
        n for n in (*SQUARENESS, *MOTIONS) if any(b and n in b.contains for b in bound.values())
    ]
    if not contains:
        return []
    star = (
        f'* holds at the target offset of its run only: {", ".join(contains)} contain rotations '
        f'that the data do not show.'
    )
    runs: dict[str, list[str]] = {}
    for name, one in bound.items():
        if one and one.contains:
            runs.setdefault(offset_words(one.offset), []).append(name)
    if len(runs) == 1:
        return [star]
    offsets = '; '.join(f'{offset}: {", ".join(names)}' for offset, names in runs.items())
    return [star, f'WARNING target offsets differ ({offsets}): compare these values among runs of '
            f'one offset only.']  # fmt: skip

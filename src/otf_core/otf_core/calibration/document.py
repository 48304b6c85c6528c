# SPDX-License-Identifier: Apache-2.0
"""From the result of a calibration to its document, the content of error_tables.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from otf_core.arrays import Array
from otf_core.budget.lines import GRID, LISTED_CORRELATION, correlations, whole_dof
from otf_core.calibration.scalar_words import location_words, squareness_words
from otf_core.calibration.views import result_views, run_view
from otf_core.model.expanded import COVERAGE_PROBABILITY
from otf_core.model.machine import SPINDLE, Machine
from otf_core.model.motions import ErrorMotion, unit_of
from otf_core.model.presets import TYPICAL
from otf_core.model.provenance import STANDARD, provenance
from otf_core.model.tables import ErrorTables, ScalarError, with_uncertainty
from otf_core.noise.noise_model import noise_to_fields
from otf_core.prediction.absorbed import offset_words
from otf_core.prediction.calibration_document import (
    BudgetBlock,
    BudgetEntry,
    CalibrationDocument,
    CorrelationBlock,
    PackedCovariance,
    PriorEntry,
    ReversalBlock,
    ReversalEntry,
    RunEntry,
    SizeEntry,
    SpacingBlock,
    SpacingCost,
    TypicalBlock,
    named_tables,
)
from otf_core.prediction.driven_volume import driven_volume, linear_positions

if TYPE_CHECKING:
    from otf_core.calibration.calibration_result import CalibrationResult, RunResult

LISTED_PAIRS = 20
"""Correlations that are listed at most."""
GAUGE = (
    'positioning and rotations zero at axis position 0, else at the minimum; '
    'straightness zero at both ends; its slope lies in squareness and alignment'
)
LINES_GAUGE = (
    'rotary axes: all six motions zero at position 0, else at the minimum; location errors are '
    'the least-squares line over the nodes'
)


def gauge_of(machine: Machine) -> str:
    """What is zero by definition in the tables of a machine."""
    return '; '.join([GAUGE, LINES_GAUGE] if machine.location else [GAUGE])


def document_of(result: CalibrationResult) -> CalibrationDocument:
    """Put together what a calibration states."""
    machine, typical = result.tables.machine, result.typical
    tables = with_uncertainty(result.tables, result.covariance, result.covariance_run)
    more, hidden = _beside(result), result.not_identifiable

    return CalibrationDocument(
        machine=machine,
        motions={n: replace(v, **more[n]) for n, v in named_tables(tables).items()},
        squareness={n: _scalar(n, v, result, more[n]) for n, v in tables.squareness.items()},
        location={n: _scalar(n, v, result, more[n]) for n, v in tables.location.items()},
        systematic=result.headline.systematic,
        targets=result.targets,
        alignment=result.T_machine_tracker,
        tracker_link=machine.tracker.link,
        headline=result.headline,
        verdicts=result.verdicts,
        not_identifiable=hidden,
        warnings=result.warnings,
        failed_gates=result.failed_gates,
        effects=result.effects,
        effects_sentence=result.effects_sentence,
        fit=result.fit,
        reversal=_reversal(result),
        runs=tuple(map(_run, result.runs)),
        run_id=result.run_id,
        gauge=gauge_of(machine),
        spacing=_spacing(result),
        prior={name: PriorEntry(size) for name, size in result.prior.items()},
        target_offset_bound=result.offset_bound,
        driven=driven_volume(
            _driven_positions(result), result.config.corner_exclusion + result.config.piece_length
        ),
        budget=_budget(result),
        correlations=_correlations(result, tables),
        typical_systematic=TypicalBlock(
            typical.missing, tuple(TYPICAL), typical.assumed, typical.warning
        )
        if typical
        else None,
        covariance=PackedCovariance.of(result.covariance, machine),
        covariance_run=PackedCovariance.of(result.covariance_run, machine),
        covariance_change=None
        if result.covariance_change is None
        else PackedCovariance.of(result.covariance_change, machine),
        config=asdict(result.config),
        **result_views(result),
        provenance=provenance(
            'calibrate', method=result.method, runs=result.origin, coverage=STANDARD
        ),
    )


def _beside(result: CalibrationResult) -> dict[str, dict[str, Any]]:
    """What stands beside the values of an error: k and dof, what would show it."""
    lines = {line.name: line for line in result.budget_lines}
    beside: dict[str, dict[str, Any]] = {}
    for name in (*result.tables.machine.motions, *result.tables.machine.scalars):
        line = lines.get(name)
        beside[name] = {'needs': result.advice.get(name)}
        beside[name] |= {'k': line.k, 'dof': whole_dof(line.dof)} if line else {}
    return beside


def _scalar(
    name: str, own: ScalarError, result: CalibrationResult, more: Mapping[str, Any]
) -> ScalarError:
    """A squareness or location error with its sentence."""
    hidden, machine, bound = (
        name in result.not_identifiable,
        result.tables.machine,
        result.offset_bound,
    )
    seen = float(not hidden)
    u, u_run = seen * own.u, seen * (own.u_run or 0.0)
    wide = (more.get('k') or 0.0) * u
    if hidden:
        need = f'; needs {more["needs"]}' if more['needs'] else ''
        words = f'{name}: not identifiable in these data{need}.'
    elif name in machine.location:
        words = location_words(machine, name, own.value, wide)
    else:
        inside = bound.contains.get(name)
        holds = (
            f', at target offset {offset_words(bound.offset)}, contains {", ".join(inside)}'
            if inside
            else ''
        )
        words = f'{name}: {squareness_words(name, own.value, wide)}{holds}.'
    return replace(own, u=u, u_run=u_run, identifiable=not hidden, words=words, **more)


def _budget(result: CalibrationResult) -> BudgetBlock:
    lines = {line.name: line for line in result.budget_lines}
    freedoms = dict(zip(result.budget.names, result.budget.freedoms.tolist(), strict=True))
    return BudgetBlock(
        coverage_probability=COVERAGE_PROBABILITY,
        dof={name: whole_dof(freedoms.get(name, np.inf)) for name in lines[GRID].parts},
        not_stated=result.budget.not_stated,
        u_rms={
            n: BudgetEntry(one.unit, one.u, one.parts, one.k, whole_dof(one.dof))
            for n, one in lines.items()
        },
    )


def _correlations(result: CalibrationResult, tables: ErrorTables) -> CorrelationBlock:
    pairs = correlations(tables, result.covariance)
    more = max(0, len(pairs) - LISTED_PAIRS)
    return CorrelationBlock(LISTED_CORRELATION, tuple(pairs[:LISTED_PAIRS]), more)


def _spacing(result: CalibrationResult) -> SpacingBlock:
    costs = sorted(result.table_costs.items())
    return SpacingBlock(
        result.fraction, tuple(SpacingCost(k, cost.grid, cost.motions) for k, cost in costs)
    )


def _driven_positions(result: CalibrationResult) -> Array:
    """Positions (n, 3) of the linear axes at the pieces; of reflectors in the spindle if any."""
    targets = result.tables.machine.targets
    spindle = np.concatenate(
        [np.array([targets[p.target].link == SPINDLE for p in run.parts])[run.part]
         for run in result.runs]
    )  # fmt: skip
    q = np.concatenate([run.q for run in result.runs])
    return linear_positions(result.tables.machine, q[spindle] if spindle.any() else q)


def driven_run(run: RunResult) -> dict[str, Any]:
    """Return how a run was driven and measured; where its residuals lie is left out."""
    own = _run(run).to_dict()
    return {k: v for k, v in own.items() if k not in ('legs', 'track', 'drift')}


def _run(run: RunResult) -> RunEntry:
    return RunEntry(
        name=run.name,
        target_offset=run.target_offset,
        parts=run.parts,
        alignment=run.T_machine_tracker,
        coverage=run.coverage,
        samples=run.samples,
        pieces=len(run.pieces),
        residual_rms=float(np.sqrt(np.mean(np.sum(run.residual**2, axis=0)))),
        noise=noise_to_fields(run.noise),
        misfit=asdict(run.misfit),
        **run_view(run),
    )


def _reversal(result: CalibrationResult) -> ReversalBlock:
    own, motions = result.reversal, {}
    for name, table in own.motions.items():
        mean = result.tables.motions[name].value
        motions[name] = ReversalEntry(
            position=table.position,
            value=table.value,
            u=table.u,
            u_run=table.u_run,
            identifiable=table.identifiable,
            forward=mean + 0.5 * table.value,
            backward=mean - 0.5 * table.value,
            axis=ErrorMotion.of(name).axis,
            unit=unit_of(name),
        )
    return ReversalBlock(
        motions=motions,
        model=own.model,
        evidence=own.evidence,
        held=own.held,
        axes={a: SizeEntry(size.value, size.u, size.u_run) for a, size in own.backlash.items()},
        lags={one.axis: SizeEntry(one.value, one.u, one.u_run) for one in result.lags},
    )

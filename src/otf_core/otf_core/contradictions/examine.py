# SPDX-License-Identifier: Apache-2.0
"""What is asked of runs that are aligned and reduced to pieces, in the order in which it counts.

First what can be mended (offsets of segments, steps of the tracker), then what the mended runs
contradict: each other, the chain, the target offsets, the noise, the range.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.contradictions.beam_breaks import settle_offsets
from otf_core.contradictions.chain import check_chain
from otf_core.contradictions.driven_range import check_driven_range
from otf_core.contradictions.noise_level import check_noise_level
from otf_core.contradictions.one_machine import check_one_machine
from otf_core.contradictions.quick_model import Model
from otf_core.contradictions.target_offset import check_target_offset
from otf_core.contradictions.tracker_moves import settle_steps
from otf_core.pieces.finding import Finding
from otf_core.pieces.runs import Run

AS_GOOD = 1.1
"""Residual with steps, over that with offsets of segments, up to which steps are the answer."""


def examine(
    runs: Sequence[Run],
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    *,
    mend: bool = True,
) -> tuple[list[Run], tuple[Finding, ...]]:
    """Examine runs for contradictions, and mend what can be mended.

    Parameters
    ----------
    runs : sequence of Run
    nodes : mapping of axis to ndarray, m
        Table nodes.
    config : CalibrationConfig
    mend : bool
        Take offsets off and cut runs at steps; else only say what is found.

    Returns
    -------
    runs : list of Run
        Mended; a run that was cut at a step is several.
    findings : tuple of Finding
        Of all runs.

    Raises
    ------
    InputError
        If the runs are of different machines.
    """
    alone: list[Model] = []
    found: list[Finding] = []
    for run in runs:
        model = Model.of([run])
        if not check_chain(model):  # its misfit is taken for a step otherwise
            model, found = _mended(model, found, nodes, config, mend=mend)
        alone.append(model)
    whole = alone[0] if len(alone) == 1 else Model.of([r for m in alone for r in m.runs])
    found += check_target_offset(whole) or check_chain(whole) or check_one_machine(whole, alone)
    found += check_driven_range(whole)
    found += check_noise_level(whole, config)
    return list(whole.runs), tuple(found)


def _mended(
    model: Model,
    found: list[Finding],
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    *,
    mend: bool,
) -> tuple[Model, list[Finding]]:
    """One run with offsets of segments and steps settled, and what was found so far.

    Steps between the breaks look like offsets of segments, and the other way round: the simpler
    answer holds where it leaves as little.
    """
    spacing = tuple(nodes[a] for a in model.rows.machine.axis_names)
    again, words = settle_offsets(model, mend=mend)
    if model.runs[0].pieces.standstill:
        return again, found + words
    stepped, steps = settle_steps(model, spacing, config, mend=mend)
    if not words or (steps and stepped.fit.ratio < AS_GOOD * again.fit.ratio):
        return stepped, found + steps
    again, steps = settle_steps(again, spacing, config, mend=mend)
    return again, found + words + steps

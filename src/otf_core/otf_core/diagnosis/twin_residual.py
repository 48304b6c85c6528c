# SPDX-License-Identifier: Apache-2.0
"""What the calibration leaves on a simulation of the same runs: the gap is what exceeds it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.residual_rows import Rows, left_by
from otf_core.live.stages import silent
from otf_core.model.frames import RigidTransform
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Recording, Run, reduced
from otf_core.solving.joint import Start, settled, solve_robustly
from otf_core.tracking.matching import OFF_PATH

Twin = Callable[[Run, RigidTransform, ErrorTables, int], Recording]
"""Simulates a run with these tables: its samples on the path, at the same moments."""


def simulated_residual_um(
    rows: Rows, nodes: Mapping[str, Array], config: CalibrationConfig, twin: Twin, seed: int = 1
) -> float:
    """Residual that the calibration leaves on the twins of runs, um.

    The functions of the motions are those chosen for the runs: the twins have their tables.

    Parameters
    ----------
    rows : Rows
        Of the runs.
    nodes : mapping of axis to ndarray, m
        Table nodes.
    twin : callable
        ``sim.twin.twin_recording``.
    seed : int
        Of the noise in the first twin; the others follow.
    """
    runs = []
    for k, (run, solved) in enumerate(zip(rows.runs, rows.done.runs, strict=True)):
        recording = twin(run, solved.pose, rows.tables, seed + k)
        leg = run.alignment.leg[run.alignment.leg != OFF_PATH]
        again = reduced(recording, replace(run.alignment, leg=leg), nodes, config)
        runs.append(replace(again, late=run.late))
    start, unknowns = Start.after(runs[0].machine, rows.done), rows.done.unknowns
    _, done = solve_robustly(runs, unknowns, config, silent, start)
    done = settled(done, config.unidentifiable_above)
    left = left_by(done, [solved.system.deviation for solved in done.runs])
    square = np.concatenate([np.sum(part**2, axis=0) for part in left])
    return float(1e6 * np.sqrt(square.mean()))

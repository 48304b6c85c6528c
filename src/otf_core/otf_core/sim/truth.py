# SPDX-License-Identifier: Apache-2.0
"""The truth of a simulated bag, to check a calibration of it by; no reader of bags needs it.

``truth_tables.json`` (layout of error_tables.json): the errors of the machine and the pose of the
tracker. ``simulation.json`` (``otf-simulation/1``): seed, effects, noise, tracker, drive.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from otf_core.config import SimulationConfig
from otf_core.effects import AppliedEffect
from otf_core.effects.effects_yaml import effects_to_data
from otf_core.files.writing import write_text
from otf_core.model.plan import Plan
from otf_core.model.provenance import origin_of, provenance
from otf_core.model.tables import tables_to_dict
from otf_core.sim.cell import SimulatedRun

TABLES_FILE, SIMULATION_FILE = 'truth_tables.json', 'simulation.json'
SCHEMA = 'otf-simulation/1'


def _pose(run: SimulatedRun) -> dict[str, Any]:
    """Pose of the tracker as in error_tables.json: it takes tracker to machine coordinates."""
    return {'rotation': run.rotation.T.tolist(), 'translation': run.place.tolist()}


def _simulation(
    run: SimulatedRun, plan: Plan, config: SimulationConfig, effects: Sequence[AppliedEffect]
) -> dict[str, Any]:
    machine = run.truth.machine
    return {
        'schema': SCHEMA,
        'seed': config.seed,
        'effects': effects_to_data(effects, machine),
        'noise': {
            'u_range': machine.tracker.u_range,
            'u_angle': machine.tracker.u_angle,
            'correlated_share': config.correlated_share,
            'correlation_time': config.correlation_time,
            'resolution': config.resolution,
            'packet_loss': config.packet_loss,
        },
        'alignment': _pose(run),
        'feed': plan.feed.tolist(),
        'dwell': plan.dwell.tolist(),
        'options': asdict(config),
        'machine': machine.to_dict(),
    }


def write_truth(
    run: SimulatedRun,
    plan: Plan,
    config: SimulationConfig,
    effects: Sequence[AppliedEffect],
    folder: Path,
    name: str,
    files: Mapping[str, str | None],
    prefix: str = '',
) -> list[Path]:
    """Write both files.

    Parameters
    ----------
    plan : Plan
        What was driven.
    folder : Path
        Exists.
    name : str
        Of the bag.
    files : mapping of str to path
        What was read, for the block ``provenance``.
    prefix : str
        Begins the names of both files.
    """
    block = provenance(
        'simulate',
        runs=[origin_of(name, run.samples, plan.path, run.truth.machine)],
        files=files,
        coverage='the truth: no uncertainty',
    )
    tables = tables_to_dict(run.truth) | {'alignment': _pose(run), 'provenance': block}
    other = _simulation(run, plan, config, effects) | {'provenance': block}
    written = []
    for file, content in ((TABLES_FILE, tables), (SIMULATION_FILE, other)):
        written.append(folder / f'{prefix}{file}')
        write_text(written[-1], json.dumps(content, indent=1) + '\n')
    return written

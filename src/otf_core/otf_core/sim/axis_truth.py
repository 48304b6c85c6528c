# SPDX-License-Identifier: Apache-2.0
"""A simulated run of a machine with rotary axes as a bag with its truth beside it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from otf_core.bags.bag import BagContent, write_bag
from otf_core.config import SimulationConfig
from otf_core.effects import AppliedEffect
from otf_core.effects.effects_yaml import effects_to_data
from otf_core.files.writing import write_text
from otf_core.model.provenance import origin_of, provenance
from otf_core.model.tables import tables_to_dict
from otf_core.sim.axis_cell import SimulatedParts
from otf_core.sim.truth import SCHEMA, SIMULATION_FILE, TABLES_FILE


def write_axis_run(
    run: SimulatedParts,
    config: SimulationConfig,
    folder: Path,
    name: str,
    effects: Sequence[AppliedEffect] = (),
) -> list[Path]:
    """Write bag and truth into a folder that exists; see ``truth``."""
    write_bag(folder, BagContent(run.samples, None, axis_paths=run.parts), overwrite=True)
    machine = run.truth.machine
    block = provenance(
        'simulate',
        runs=[origin_of(name, run.samples, None, machine)],
        coverage='the truth: no uncertainty',
    )
    pose = {'rotation': run.rotation.T.tolist(), 'translation': run.place.tolist()}
    targets = {n: {'place': p.tolist(), 'u': [0.0] * 3} for n, p in run.places.items()}
    tables = tables_to_dict(run.truth) | {'alignment': pose, 'targets': targets}
    about = {
        'schema': SCHEMA,
        'seed': config.seed,
        'alignment': pose,
        'parts': [{'target': p.target, 'corners': p.positions.tolist()} for p in run.parts],
        'options': asdict(config),
        **({'effects': effects_to_data(effects, machine)} if effects else {}),
        'machine': machine.to_dict(),
    }
    written = []
    for file, content in ((TABLES_FILE, tables), (SIMULATION_FILE, about)):
        written.append(folder / file)
        write_text(written[-1], json.dumps(content | {'provenance': block}, indent=1) + '\n')
    return written

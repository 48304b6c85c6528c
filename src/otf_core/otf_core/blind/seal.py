# SPDX-License-Identifier: Apache-2.0
"""Bags and machine.yaml of every cell, and the key beside them, sealed by its hash.

DIR/cells/NNN/bag (bag_2 from a second tracker place) and machine.yaml are all that a diagnosis
sees; DIR/key.json is opened for scoring only; DIR/key.sha256 shows that it has not changed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from otf_core.bags.bag import BagContent, write_bag
from otf_core.blind.cases import Case, Part, draw_case, kinds_of
from otf_core.blind.depends import WITHOUT
from otf_core.errors import InputError
from otf_core.files.manifest import MANIFEST
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.provenance import provenance

KEY, SEAL = 'key.json', 'key.sha256'
SCHEMA = 'otf-blind-key/2'

Entry = dict[str, Any]


@dataclass(frozen=True)
class Order:
    """What cell to draw; the arguments of ``cases.draw_case``."""

    seed: int
    number: int
    kind: str
    turn: int
    names: tuple[str, ...] = ()

    @property
    def cell(self) -> str:
        """Name of the folder of the cell."""
        return f'{self.number:03d}'


def orders(trials: int, seed: int, *, leave_one_out: bool = False) -> list[Order]:
    """List the cells of a trial; with ``leave_one_out`` the effects of ``WITHOUT`` in turn."""
    if leave_one_out:
        return [Order(seed, k, 'one', 0, (WITHOUT[k % len(WITHOUT)],)) for k in range(trials)]
    return [Order(seed, k, *kind) for k, kind in enumerate(kinds_of(trials, seed))]


def _parts(parts: Sequence[Part]) -> list[Entry]:
    return [
        {
            'effect': p.name,
            'names': list(p.names),
            'depends': p.depends.to_dict(),
            'parameters': {k: float(v) for k, v in p.applied.parameters.items()},
            'size_um': 1e6 * p.size,
            'raw_um': 1e6 * p.raw,
            'snr': p.snr,
        }
        for p in parts
    ]


def key_entry(order: Order, case: Case) -> Entry:
    """What the key says about one cell."""
    trial = case.trial
    return {
        'cell': order.cell,
        'seed': order.seed,
        'number': order.number,
        'kind': case.kind,
        'parts': _parts(case.parts),
        'first_place_only': _parts(case.first_only),
        'measured_um': 1e6 * case.measured,
        'simulated_um': 1e6 * case.simulated,
        'bends_um': 1e6 * case.bends,
        'chain': str(trial.machine.chain),
        'places': len(trial.configs),
        'duration': trial.plan.duration,
        'feeds': sorted({round(float(f), 4) for f in trial.plan.feed}),
        'heavy_tails': trial.tails is not None,
    }


def write_cell(order: Order, folder: Path) -> Entry:
    """Draw one cell, write what a diagnosis may see, return its entry of the key."""
    case = draw_case(order.seed, order.number, order.kind, order.turn, order.names)
    cell = ensure_folder(folder / 'cells' / order.cell)
    description = yaml.safe_dump(case.trial.machine.to_dict(), sort_keys=False)
    write_text(cell / 'machine.yaml', description)
    for k, run in enumerate(case.trial.runs(case.effects)):
        name = 'bag' if k == 0 else f'bag_{k + 1}'
        content = BagContent(run.samples, case.trial.plan.path)
        write_bag(cell / name, content, overwrite=True)
    return key_entry(order, case)


def seal(wanted: Sequence[Order], folder: Path, jobs: int, progress: Callable[[str], None]) -> str:
    """Write all cells and the key.

    Parameters
    ----------
    wanted : sequence of Order
    folder : Path
    jobs : int
        Processes.
    progress : callable(str)

    Returns
    -------
    str
        SHA-256 of the key.
    """
    entries = []
    with ProcessPoolExecutor(jobs) as pool:
        for entry in pool.map(write_cell, wanted, [folder] * len(wanted)):
            entries.append(entry)
            progress(f'cell {entry["cell"]} drawn')
    content = {'schema': SCHEMA, 'cells': entries, 'provenance': provenance('blind')}
    text = json.dumps(content, indent=1)
    write_text(folder / KEY, text)
    digest = hashlib.sha256(text.encode()).hexdigest()
    write_text(folder / SEAL, digest + '\n')
    return digest


def holds_trial(folder: str | Path) -> bool:
    """Tell whether a trial was begun in a folder, so that it goes on there."""
    folder = Path(folder)
    if not folder.is_dir():
        return False
    names = {p.name for p in folder.iterdir()}
    return SEAL in names or (bool(names) and names <= {'cells', KEY, MANIFEST})


def open_key(folder: Path) -> list[Entry]:
    """Read the key; InputError if it is not the one that was sealed."""
    try:
        text = (folder / KEY).read_text(encoding='utf-8')
        digest = (folder / SEAL).read_text(encoding='utf-8').strip()
    except OSError as error:
        raise InputError(f'{folder}: key cannot be read ({error.strerror})') from None
    if hashlib.sha256(text.encode()).hexdigest() != digest:
        raise InputError(f'{folder / KEY}: is not the key that was sealed')
    cells: list[Entry] = json.loads(text)['cells']
    return cells

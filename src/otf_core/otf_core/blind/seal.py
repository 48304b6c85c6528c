# SPDX-License-Identifier: Apache-2.0
"""Bags and machine.yaml of every cell, and the key beside them, sealed by its hash.

DIR/cells/NNN/bag (bag_2 from a second tracker place) and machine.yaml are all that a diagnosis
sees; DIR/key.json is opened for scoring only; DIR/key.sha256 shows that it has not changed.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from otf_core.bags.bag import BagContent, write_bag
from otf_core.blind.axis_cases import AXIS_KINDS, axis_entry, draw_axis_case, seen_positions
from otf_core.blind.cases import KINDS, Case, Part, draw_case, kinds_of
from otf_core.blind.depends import WITHOUT
from otf_core.errors import ConfigError, InputError
from otf_core.files.output_folder import MANIFEST
from otf_core.files.strict_yaml import read_json
from otf_core.files.writing import ensure_folder, write_text
from otf_core.fleet.fleet import RESULT, STATE, JobResult, Workers, call_job, run_fleet
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


def orders(
    trials: int, seed: int, *, leave_one_out: bool = False, five_axes: bool = False
) -> list[Order]:
    """List the cells of a trial.

    Parameters
    ----------
    leave_one_out : bool
        The effects of ``WITHOUT`` in turn.
    five_axes : bool
        Only families of machines with rotary axes.
    """
    if leave_one_out:
        return [Order(seed, k, 'one', 0, (WITHOUT[k % len(WITHOUT)],)) for k in range(trials)]
    kinds = kinds_of(trials, seed, tuple(AXIS_KINDS if five_axes else KINDS))
    return [Order(seed, k, *kind) for k, kind in enumerate(kinds)]


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
    if order.kind in AXIS_KINDS:
        return _write_axis_cell(order, folder)
    case = draw_case(order.seed, order.number, order.kind, order.turn, order.names)
    cell = ensure_folder(folder / 'cells' / order.cell)
    description = yaml.safe_dump(case.trial.machine.to_dict(), sort_keys=False)
    write_text(cell / 'machine.yaml', description)
    for k, run in enumerate(case.trial.runs(case.effects)):
        name = 'bag' if k == 0 else f'bag_{k + 1}'
        content = BagContent(run.samples, case.trial.plan.path, signals=run.signals)
        write_bag(cell / name, content, overwrite=True)
    return key_entry(order, case)


def _write_axis_cell(order: Order, folder: Path) -> Entry:
    """The same of a machine with rotary axes."""
    case = draw_axis_case(order.seed, order.number, order.kind, order.turn)
    cell = ensure_folder(folder / 'cells' / order.cell)
    write_text(cell / 'machine.yaml', yaml.safe_dump(case.cell.machine.spec, sort_keys=False))
    samples = case.cell.measured(seen_positions(case))
    content = BagContent(samples, None, axis_paths=case.cell.paths())
    write_bag(cell / 'bag', content, overwrite=True)
    known = {'cell': order.cell, 'seed': order.seed, 'number': order.number, 'kind': order.kind}
    return {**known, **axis_entry(case)}


def draw_cell(folder: str, **order: Any) -> Entry:
    """Draw the cell of one order, given as plain data; see ``write_cell``."""
    order['names'] = tuple(order['names'])
    return write_cell(Order(**order), Path(folder))


def _run_name(cell: str) -> str:
    return f'drawn-{cell}'


def seal(
    wanted: Sequence[Order],
    folder: Path,
    workers: Workers,
    progress: Callable[[str], None],
) -> dict[str, JobResult]:
    """Write all cells and the key; unless they are there from a trial that was interrupted.

    A cell that cannot be drawn is named in the key, and the trial goes on without it.

    Parameters
    ----------
    workers : callable(jobs)
        See ``fleet.fleet``.

    Returns
    -------
    mapping of name to JobResult
        Of those that could not be drawn.

    Raises
    ------
    ConfigError
        If the folder holds another trial.
    """
    if not (folder / SEAL).exists():
        _draw(wanted, folder, workers, progress)
        progress(f'key sealed, SHA-256 {read_seal(folder)}')
    key = _read_key(folder)
    drawn = {(e['seed'], e['cell'], e['kind']) for e in key['cells']}
    cells = sorted([*key['not_drawn'], *(e['cell'] for e in key['cells'])])
    if not drawn <= {(o.seed, o.cell, o.kind) for o in wanted} or cells != sorted(
        o.cell for o in wanted
    ):
        raise ConfigError(f'{folder}: holds another trial; choose another folder')
    return {_run_name(c): JobResult(1, said, None) for c, said in key['not_drawn'].items()}


def _draw(
    wanted: Sequence[Order], folder: Path, workers: Workers, progress: Callable[[str], None]
) -> None:
    """Draw every cell in a process of its own, and seal the key."""
    base = folder.absolute()
    jobs = [
        call_job(
            _run_name(order.cell),
            f'{__name__}:draw_cell',
            {'folder': str(base), **asdict(order)},
            base / STATE / 'drawn' / order.cell,
        )
        for order in wanted
    ]
    outcomes = run_fleet(jobs, folder, workers, progress)
    entries, not_drawn = [], {}
    for order, job in zip(wanted, jobs, strict=True):
        ended = outcomes[job.name]
        if ended.done:
            entries.append(read_json(Path(job.out) / RESULT))
        else:
            not_drawn[order.cell] = ended.message
            shutil.rmtree(folder / 'cells' / order.cell, ignore_errors=True)
    block = provenance('blind')
    content = {'schema': SCHEMA, 'cells': entries, 'not_drawn': not_drawn, 'provenance': block}
    text = json.dumps(content, indent=1)
    write_text(folder / KEY, text)
    write_text(folder / SEAL, hashlib.sha256(text.encode()).hexdigest() + '\n')


def read_seal(folder: Path) -> str:
    """SHA-256 of the key, as it was sealed."""
    return (folder / SEAL).read_text(encoding='utf-8').strip()


def holds_trial(folder: str | Path) -> bool:
    """Return whether a trial was begun in a folder, so that it goes on there."""
    folder = Path(folder)
    if not folder.is_dir():
        return False
    names = {p.name for p in folder.iterdir()}
    return SEAL in names or (bool(names) and names <= {'cells', STATE, KEY, MANIFEST})


def open_key(folder: Path) -> list[Entry]:
    """Read the key; InputError if it is not the one that was sealed."""
    cells: list[Entry] = _read_key(folder)['cells']
    return cells


def _read_key(folder: Path) -> dict[str, Any]:
    try:
        text = (folder / KEY).read_text(encoding='utf-8')
        digest = read_seal(folder)
    except OSError as error:
        raise InputError(f'{folder}: key cannot be read ({error.strerror})') from None
    if hashlib.sha256(text.encode()).hexdigest() != digest:
        raise InputError(f'{folder / KEY}: is not the key that was sealed')
    key: dict[str, Any] = json.loads(text)
    return key

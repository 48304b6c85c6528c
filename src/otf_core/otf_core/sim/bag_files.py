# SPDX-License-Identifier: Apache-2.0
"""A simulated run as a bag with its truth: a rosbag2 folder, or an .mcap file with siblings.

``truth_tables.json`` (layout of error_tables.json): the errors of the machine, the pose of the
tracker and the places of the reflectors, to check a calibration by. ``simulation.json``
(``otf-simulation/1``): seed, effects, what was driven, options.

In a folder, truth and manifest lie beside metadata.yaml, where no reader of bags looks. Beside
NAME.mcap lie NAME.truth_tables.json, NAME.simulation.json and NAME.manifest.json. What was
recorded otherwise has no such manifest and is never overwritten.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from otf_core.arrays import Array
from otf_core.bags.bag import FILE_NAME, BagContent, write_bag
from otf_core.config import SimulationConfig
from otf_core.documents import Document, ResultDocument, stated
from otf_core.effects import AppliedEffect
from otf_core.effects.effects_yaml import effects_to_data
from otf_core.errors import ConfigError
from otf_core.files.output_folder import (
    MANIFEST,
    OutputFile,
    OutputFolder,
    is_unchanged,
    listed_files,
    write_manifest,
)
from otf_core.files.writing import write_text
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.provenance import origin_of, provenance
from otf_core.prediction.calibration_document import CalibrationDocument, TargetPlace
from otf_core.sim.cell import SimulatedRun

TABLES_FILE, SIMULATION_FILE = 'truth_tables.json', 'simulation.json'


class SimulatedBag:
    """Place of a simulated bag; ConfigError at once if it cannot be written there.

    Parameters
    ----------
    path : str or Path
        A file if it ends in .mcap, else a folder.
    overwrite : bool
        Replace a simulated bag that is there.
    inputs : sequence of str or Path
        What the command reads.
    """

    def __init__(
        self, path: str | Path, *, overwrite: bool = False, inputs: Sequence[str | Path] = ()
    ) -> None:
        self._path = Path(path)
        self._folder: OutputFolder | None = None
        if self._path.suffix != '.mcap':
            self._folder = OutputFolder(
                path, overwrite=overwrite, inputs=inputs, occupied='exists already'
            )
            return
        self._files = [
            OutputFile(p, self._is_ours, overwrite=overwrite, inputs=inputs)
            for p in (self._path, *map(self._sibling, (TABLES_FILE, SIMULATION_FILE)))
        ]
        OutputFile(
            self._sibling(MANIFEST),
            lambda p: bool(listed_files(p)),
            overwrite=overwrite,
            inputs=inputs,
        )

    def _sibling(self, name: str) -> Path:
        return self._path.with_name(f'{self._path.stem}.{name}')

    def _is_ours(self, path: Path) -> bool:
        manifest = self._sibling(MANIFEST)
        known = {p.resolve(): digest for p, digest in listed_files(manifest).items()}
        return is_unchanged(path, known)

    def write(
        self,
        run: SimulatedRun,
        config: SimulationConfig,
        effects: Sequence[AppliedEffect],
        files: Mapping[str, str | None],
    ) -> None:
        """Write bag and truth; the bag last, and nothing half.

        Parameters
        ----------
        files : mapping of str to path
            What was read, for the block ``provenance``.
        """
        parts = run.parts if run.path is None else ()
        content = BagContent(run.samples, run.path, signals=run.signals, axis_paths=parts)
        if self._folder is not None:
            with self._folder.filled('simulate') as folder:
                write_bag(folder, content, overwrite=True)
                _write_truth(run, config, effects, folder, self._path.name, files)
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with TemporaryDirectory(prefix='.otf-', dir=self._path.parent) as name:
                folder = Path(name)
                write_bag(folder / 'bag', content)
                written = _write_truth(run, config, effects, folder, self._path.stem, files)
                self._put_in_place([folder / 'bag' / FILE_NAME, *written])
        except OSError as error:
            raise ConfigError(f'{self._path}: cannot be written ({error.strerror})') from None

    def _put_in_place(self, new: Sequence[Path]) -> None:
        for source, target in reversed(list(zip(new, self._files, strict=True))):
            with target.filled() as partial:
                source.replace(partial)
        written = [file.path for file in self._files]
        write_manifest(self._sibling(MANIFEST), written, 'simulate')


@dataclass(frozen=True)
class DrivenPlan(Document):
    """A part of what was driven."""

    target: str = stated('name of the reflector')
    corners: Array = stated('axis positions', 'm or rad', shape=('n', 'axes'))
    feed: Array = stated('of every leg', 'm/s', shape=('m',))
    dwell: Array = stated('at every corner', 's', shape=('n',))


@dataclass(frozen=True)
class SimulationDocument(ResultDocument):
    """How a simulated bag came about; its true errors are in truth_tables.json."""

    file = SIMULATION_FILE

    seed: int = stated('of all random draws')
    effects: tuple[Mapping[str, Any], ...] = stated('added to the cell, as in effects.yaml')
    alignment: RigidTransform = stated('takes tracker to machine coordinates')
    parts: tuple[DrivenPlan, ...] = stated('in driving order')
    options: Mapping[str, Any] = stated('of the simulation')
    machine: Machine = stated('machine.yaml')
    schema: str = stated('otf-simulation/1', default='otf-simulation/1')
    provenance: Mapping[str, Any] = stated('when, from what, by what', factory=dict)


def _write_truth(
    run: SimulatedRun,
    config: SimulationConfig,
    effects: Sequence[AppliedEffect],
    folder: Path,
    name: str,
    files: Mapping[str, str | None],
) -> list[Path]:
    """Write both files into a folder that exists."""
    machine = run.truth.machine
    block = provenance(
        'simulate',
        runs=[origin_of(name, run.samples, run.path, machine)],
        files=files,
        coverage='the truth: no uncertainty',
    )
    targets = {n: TargetPlace(machine.targets[n].link, p) for n, p in run.places.items()}
    tables = CalibrationDocument.of_tables(
        run.truth, alignment=run.pose, targets=targets, provenance=block
    )
    parts = [
        DrivenPlan(part.target, part.path.positions, part.feed, part.dwell)
        for part in (drive.part for drive in run.drives)
    ]
    about = SimulationDocument(
        config.seed, tuple(effects_to_data(effects, machine)), run.pose, tuple(parts),
        asdict(config), machine, provenance=block,
    )  # fmt: skip
    for file, document in ((TABLES_FILE, tables), (SIMULATION_FILE, about)):
        write_text(folder / file, json.dumps(document.to_dict(), indent=1) + '\n')
    return [folder / TABLES_FILE, folder / SIMULATION_FILE]

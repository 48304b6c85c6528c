# SPDX-License-Identifier: Apache-2.0
"""A simulated run as a bag with its truth: a rosbag2 folder, or an .mcap file with siblings.

In a folder, truth and manifest lie beside metadata.yaml, where no reader of bags looks. Beside
NAME.mcap lie NAME.truth_tables.json, NAME.simulation.json and NAME.manifest.json. What was
recorded otherwise has no such manifest and is never overwritten.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from otf_core.bags.bag import FILE_NAME, BagContent, write_bag
from otf_core.config import SimulationConfig
from otf_core.effects import AppliedEffect
from otf_core.errors import ConfigError
from otf_core.files.output_folder import (
    MANIFEST,
    OutputFile,
    OutputFolder,
    is_unchanged,
    listed_files,
    write_manifest,
)
from otf_core.model.plan import Plan
from otf_core.sim.cell import SimulatedRun
from otf_core.sim.truth import SIMULATION_FILE, TABLES_FILE, write_truth


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
        plan: Plan,
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
        content = BagContent(run.samples, plan.path, signals=run.signals)
        if self._folder is not None:
            with self._folder.filled('simulate') as folder:
                write_bag(folder, content, overwrite=True)
                write_truth(run, plan, config, effects, folder, self._path.name, files)
            return
        try:
            with TemporaryDirectory(prefix='.otf-', dir=self._parent()) as name:
                folder = Path(name)
                write_bag(folder / 'bag', content)
                written = write_truth(run, plan, config, effects, folder, self._path.stem, files)
                new = [folder / 'bag' / FILE_NAME, *written]
                self._put_in_place(new)
        except OSError as error:
            raise ConfigError(f'{self._path}: cannot be written ({error.strerror})') from None

    def _parent(self) -> Path:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        return self._path.parent

    def _put_in_place(self, new: Sequence[Path]) -> None:
        for source, target in reversed(list(zip(new, self._files, strict=True))):
            with target.filled() as partial:
                source.replace(partial)
        written = [file.path for file in self._files]
        write_manifest(self._sibling(MANIFEST), written, 'simulate')

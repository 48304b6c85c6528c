# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of sealed cells: one process per cell, which sees bags and machine.yaml only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from otf_core.files.strict_yaml import read_json
from otf_core.fleet.fleet import VERBS, Job, JobResult, Workers, hash_of, run_fleet
from otf_core.sim.cell import EPOCH_NS

Answer = dict[str, Any]

GAP = 'gap.json'
LIMIT = 1200.0
"""s; a diagnosis that takes longer has failed: half a minute is usual."""


@dataclass(frozen=True)
class Question:
    """One diagnosis.

    Attributes
    ----------
    bags : tuple of str
        Names of bags within the cell.
    exclude : tuple of str
        Effects taken out of the catalogue.
    label : str
        Folder of the answer beside those of other questions.
    """

    cell: str
    bags: tuple[str, ...] = ('bag',)
    exclude: tuple[str, ...] = ()
    label: str = 'answers'

    @property
    def name(self) -> str:
        """Name of its run in the trial."""
        return f'{self.label}-{self.cell}'


def answer_file(folder: Path, question: Question) -> Path:
    """Where the answer to a question lies."""
    return folder / question.label / question.cell / GAP


def _job(question: Question, folder: Path, sealed: str) -> Job:
    """Diagnose a cell from within the folder of the trial, so that no answer names it."""
    cell, out = f'cells/{question.cell}', f'{question.label}/{question.cell}'
    words = [VERBS, 'diagnose', *(f'{cell}/{b}' for b in question.bags)]
    words += ['--machine', f'{cell}/machine.yaml', '--out', out, '--overwrite', '--quiet']
    for name in question.exclude:
        words += ['--exclude', name]
    folder = folder.absolute()
    return Job(
        name=question.name,
        words=tuple(words),
        out=str(folder / out),
        result=GAP,
        inputs=hash_of(sealed, words),
        date=EPOCH_NS // 10**9,
        folder=str(folder),
        limit=LIMIT,
    )


def ask_all(
    questions: Sequence[Question],
    folder: Path,
    sealed: str,
    workers: Workers,
    progress: Callable[[str], None],
) -> tuple[dict[tuple[str, str], Answer], dict[str, JobResult]]:
    """Diagnose all.

    Parameters
    ----------
    folder : Path
        Of the trial.
    sealed : str
        Hash of its key: other cells are other questions.
    workers : callable(jobs)
        See ``fleet.fleet``.

    Returns
    -------
    answers : mapping of label and cell to mapping
        gap.json, or the key ``failed`` with the message of the command.
    outcomes : mapping of name to JobResult
    """
    jobs = [_job(question, folder, sealed) for question in questions]
    outcomes = run_fleet(jobs, folder, workers, progress)
    answers: dict[tuple[str, str], Answer] = {}
    for question in questions:
        ended = outcomes[question.name]
        found = read_json(answer_file(folder, question)) if ended.done else None
        answers[question.label, question.cell] = found or {
            'failed': ended.message or f'exit code {ended.exit}'
        }
    return answers, outcomes

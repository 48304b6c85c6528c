# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of sealed cells: one process per cell, which sees bags and machine.yaml only."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from otf_core.files.writing import ensure_folder, write_text
from otf_core.live.time_left import StepsLeft

Answer = dict[str, Any]

LIMIT = 1200.0
"""s; a diagnosis that takes longer has failed: half a minute is usual."""


@dataclass(frozen=True)
class Question:
    """One diagnosis.

    Attributes
    ----------
    cell : str
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


def ask(question: Question, folder: Path) -> Answer:
    """Diagnose one cell; an answer that is there already is read.

    Returns
    -------
    mapping
        gap.json, or the key ``failed`` with the message of the command.
    """
    cell = folder / 'cells' / question.cell
    out = folder / question.label / question.cell
    if not (out / 'gap.json').exists():
        command = [sys.executable, '-m', 'otf_core.cli', 'diagnose']
        command += [str(cell / b) for b in question.bags]
        command += ['--machine', str(cell / 'machine.yaml'), '--out', str(out)]
        for name in question.exclude:
            command += ['--exclude', name]
        start = time.monotonic()
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=LIMIT
            )
        except subprocess.TimeoutExpired:
            return {'failed': f'took longer than {LIMIT:.0f} s'}
        if done.returncode not in (0, 4) or not (out / 'gap.json').exists():
            return {'failed': done.stderr.strip()[-500:] or f'exit code {done.returncode}'}
        write_text(ensure_folder(out) / 'seconds.txt', f'{time.monotonic() - start:.1f}\n')
    answer: Answer = json.loads((out / 'gap.json').read_text(encoding='utf-8'))
    return answer


def ask_all(
    questions: Sequence[Question], folder: Path, jobs: int, progress: Callable[[str], None]
) -> dict[tuple[str, str], Answer]:
    """Diagnose all; the answers by label and cell."""
    answers, left = {}, StepsLeft(len(questions))
    with ThreadPoolExecutor(jobs) as pool:
        results = pool.map(ask, questions, [folder] * len(questions))
        for question, answer in zip(questions, results, strict=True):
            answers[question.label, question.cell] = answer
            said = answer.get('verdict') or f'failed: {answer["failed"]}'
            progress(f'cell {question.cell}: {said}{left.after_one()}')
    return answers

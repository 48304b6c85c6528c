# SPDX-License-Identifier: Apache-2.0
"""The blind trial: draw and seal, diagnose, open the key, score."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from otf_core.blind.answers import Answer, Question, ask_all
from otf_core.blind.depends import kin_of
from otf_core.blind.outcome import NOISE, Outcome, outcome
from otf_core.blind.publish import PARTICULARS, README, Measured, fragment
from otf_core.blind.recovery import Recovery, recover, ruler_of
from otf_core.blind.score import score_to_dict
from otf_core.blind.seal import KEY, SEAL, Entry, Order, open_key, orders, seal
from otf_core.blind.table import (
    Table,
    as_text,
    criteria,
    misses,
    particulars,
    shrink_words,
    without_itself,
)
from otf_core.errors import ConfigError
from otf_core.files.manifest import MANIFEST, write_manifest, written_files
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.provenance import provenance

Progress = Callable[[str], None]

WHOLE, FIRST, WITHOUT = 'answers', 'answers_first_place', 'answers_without'


def _bags(folder: Path, cell: str) -> tuple[str, ...]:
    return tuple(sorted(p.name for p in (folder / 'cells' / cell).glob('bag*')))


def _blind_questions(folder: Path, cells: Sequence[str]) -> list[Question]:
    """All bags of every cell; where there are several, the first alone as well."""
    questions = []
    for cell in cells:
        bags = _bags(folder, cell)
        questions.append(Question(cell, bags))
        if len(bags) > 1:
            questions.append(Question(cell, bags[:1], label=FIRST))
    return questions


def _recover(entry: Entry, answer: Answer) -> Recovery | None:
    return recover(entry, answer, ruler_of(entry))


def _score(
    folder: Path, entries: Sequence[Entry], answers: dict[tuple[str, str], Answer], jobs: int
) -> str:
    outcomes, alone = [], []
    for entry in entries:
        outcomes.append(outcome(entry, answers[WHOLE, entry['cell']]))
        if (FIRST, entry['cell']) in answers:
            answer = answers[FIRST, entry['cell']]
            alone.append(outcome(entry, answer, first_place=True))
    sized = [e for e in entries if e['parts'] and 'failed' not in answers[WHOLE, e['cell']]]
    sized = [e for e in sized if all(p['effect'] not in NOISE for p in e['parts'])]
    with ProcessPoolExecutor(jobs) as pool:
        results = pool.map(_recover, sized, [answers[WHOLE, e['cell']] for e in sized])
        recovered = [r for r in results if r is not None]
    main, rest = criteria(outcomes, recovered, alone), particulars(outcomes)
    _publish(folder, score_to_dict(outcomes, recovered, alone), main, rest)
    every = [*main, *rest, misses([*outcomes, *alone])]
    return '\n\n'.join([f'{len(outcomes)} cells', *map(as_text, every), shrink_words(recovered)])


def _publish(
    folder: Path,
    data: Mapping[str, Any],
    main: Sequence[Table],
    rest: Sequence[Table],
    *,
    leave_one_out: bool = False,
) -> None:
    """Write score.json, and the tables as README and docs hold them."""
    block = provenance('blind', files={'key': folder / KEY})
    write_text(folder / 'score.json', json.dumps({**data, 'provenance': block}, indent=1))
    measured = Measured.of(folder, open_key(folder), block['written'][:10], leave_one_out)
    write_text(folder / README, fragment(measured, main))
    write_text(folder / PARTICULARS, fragment(measured, rest))


def _draw(wanted: Sequence[Order], folder: Path, jobs: int, progress: Progress) -> None:
    """Draw the cells, unless they are there from a trial that was interrupted."""
    if (folder / SEAL).exists():
        drawn = [(e['seed'], e['cell'], e['kind']) for e in open_key(folder)]
        if drawn != [(o.seed, o.cell, o.kind) for o in wanted]:
            raise ConfigError(f'{folder}: holds another trial; choose another folder')
        return
    digest = seal(wanted, folder, jobs, progress)
    progress(f'key sealed, SHA-256 {digest}')


def list_files(folder: Path) -> None:
    """Write the manifest of a trial, whole or interrupted: of what it writes, nothing else."""
    parts = ('cells', WHOLE, FIRST, WITHOUT, KEY, SEAL, README, PARTICULARS, 'score.json',
             'score.txt')  # fmt: skip
    files = [f for f in written_files(folder) if f.relative_to(folder).parts[0] in parts]
    if files:
        write_manifest(folder / MANIFEST, files, 'blind')


def run_trial(
    trials: int,
    seed: int,
    folder: str | Path,
    jobs: int = 2,
    progress: Progress = lambda text: None,
) -> str:
    """Run a blind trial; an interrupted one goes on where it was.

    Parameters
    ----------
    trials : int
        Cells.
    seed : int
    folder : str or Path
    jobs : int
        Processes at once.
    progress : callable(str)

    Returns
    -------
    str
        The table; ``score.txt`` and ``score.json`` hold it too.
    """
    folder = ensure_folder(folder)
    _draw(orders(trials, seed), folder, jobs, progress)
    cells = sorted(p.name for p in (folder / 'cells').iterdir())
    answers = ask_all(_blind_questions(folder, cells), folder, jobs, progress)
    text = _score(folder, open_key(folder), answers, jobs)
    write_text(folder / 'score.txt', text + '\n')
    return text


def run_leave_one_out(
    trials: int,
    seed: int,
    folder: str | Path,
    jobs: int = 2,
    progress: Progress = lambda text: None,
) -> str:
    """Diagnose runs with their effect and its kin taken out of the catalogue; as ``run_trial``.

    What is taken out is taken out in every form.
    """
    folder = ensure_folder(folder)
    _draw(orders(trials, seed, leave_one_out=True), folder, jobs, progress)
    entries = open_key(folder)
    questions = [
        Question(e['cell'], ('bag',), kin_of(e['parts'][0]['effect']), WITHOUT) for e in entries
    ]
    answers = ask_all(questions, folder, jobs, progress)
    outcomes: list[Outcome] = []
    recovered: dict[str, Recovery] = {}
    for entry, question in zip(entries, questions, strict=True):
        answer = answers[WITHOUT, entry['cell']]
        outcomes.append(outcome(entry, answer, question.exclude))
        if outcomes[-1].named:
            found = _recover(entry, answer)
            recovered |= {entry['cell']: found} if found else {}
    main, *rest = without_itself(outcomes, recovered)
    data = score_to_dict(outcomes, list(recovered.values()))
    _publish(folder, data, [main], rest, leave_one_out=True)
    text = '\n\n'.join(map(as_text, [main, *rest]))
    write_text(folder / 'score.txt', text + '\n')
    return text

# SPDX-License-Identifier: Apache-2.0
"""The blind trial: draw and seal, diagnose, open the key, score.

Every diagnosis is one process, which sees bags and machine.yaml only.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from otf_core.blind.axis_cases import AXIS_KINDS
from otf_core.blind.depends import kin_of
from otf_core.blind.outcome import NOISE, Outcome, outcome
from otf_core.blind.publish import (
    DIAGRAM,
    FIVE_AXES,
    LEAVE_ONE_OUT,
    TABLE,
    Table,
    TrialConditions,
    as_text,
    criteria,
    fragment,
    leave_one_out_table,
    misses,
    particulars,
    reliability_svg,
    shrink_words,
    sizes_words,
)
from otf_core.blind.recovery import Recovery, recovery_from
from otf_core.blind.score import reliability, score_to_dict, stated_confidences
from otf_core.blind.seal import KEY, SEAL, Entry, open_key, orders, read_seal, seal
from otf_core.files.output_folder import MANIFEST, file_digest, write_manifest, written_files
from otf_core.files.strict_yaml import read_json
from otf_core.files.writing import ensure_folder, write_text
from otf_core.fleet import fleet
from otf_core.fleet.fleet import (
    RESULT,
    STATE,
    VERBS,
    Job,
    JobResult,
    Workers,
    call_job,
    hash_of,
    run_fleet,
)
from otf_core.model.provenance import provenance
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
        answer = read_json(answer_file(folder, question)) if ended.done else None
        answers[question.label, question.cell] = answer or {
            'failed': ended.message or f'exit code {ended.exit}'
        }
    return answers, outcomes


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


def _recover_all(
    asked: Iterable[tuple[Entry, Question]],
    folder: Path,
    workers: Workers,
    progress: Callable[[str], None],
) -> tuple[dict[str, Recovery], dict[str, JobResult]]:
    """Compare answers with the truth, cell by cell, each in a process of its own."""
    jobs = []
    for entry, question in asked:
        file = answer_file(folder, question).absolute()
        jobs.append(
            call_job(
                f'size-{question.name}',
                'otf_core.blind.recovery:recover_cell',
                {'entry': entry, 'answer': str(file)},
                folder / STATE / 'sizes' / question.name,
                depends=[file_digest(file)],
            )
        )
    ended = run_fleet(jobs, folder, workers, progress)
    recovered = (read_json(Path(j.out) / RESULT) for j in jobs if ended[j.name].done)
    return {data['cell']: recovery_from(data) for data in recovered if data}, ended


def _score(
    folder: Path,
    entries: Sequence[Entry],
    answers: dict[tuple[str, str], Answer],
    recovered: Sequence[Recovery],
    option: str,
) -> str:
    outcomes, alone = [], []
    for entry in entries:
        outcomes.append(outcome(entry, answers[WHOLE, entry['cell']]))
        if (FIRST, entry['cell']) in answers:
            answer = answers[FIRST, entry['cell']]
            alone.append(outcome(entry, answer, first_place=True))
    main, rest = criteria(outcomes), particulars(outcomes, recovered, alone)
    write_text(folder / DIAGRAM, reliability_svg(reliability(stated_confidences(outcomes))))
    data = score_to_dict(outcomes, recovered, alone)
    _publish(folder, data, main, sizes_words(recovered, outcomes), option)
    every = [main, *rest, misses([*outcomes, *alone])]
    return '\n\n'.join([f'{len(outcomes)} cells', *map(as_text, every), shrink_words(recovered)])


def _publish(
    folder: Path,
    data: Mapping[str, Any],
    main: Table,
    words: str = '',
    option: str = '',
) -> None:
    """Write score.json, and the table as the docs hold it."""
    block = provenance('blind', files={'key': folder / KEY})
    write_text(folder / 'score.json', json.dumps({**data, 'provenance': block}, indent=1))
    measured = TrialConditions.of(folder, open_key(folder), block['written'][:10], option)
    write_text(folder / TABLE, fragment(measured, main, words))


def list_files(folder: Path) -> None:
    """Write the manifest of a trial, whole or interrupted: of what it writes, nothing else."""
    parts = ('cells', WHOLE, FIRST, WITHOUT, STATE, KEY, SEAL, TABLE, DIAGRAM,
             'score.json', 'score.txt', fleet.FILE)  # fmt: skip
    files = [f for f in written_files(folder) if f.relative_to(folder).parts[0] in parts]
    if files:
        write_manifest(folder / MANIFEST, files, 'blind')


@dataclass(frozen=True)
class TrialResult:
    """What a trial came to.

    Attributes
    ----------
    words : str
        The tables; ``score.txt`` and ``score.json`` hold them too.
    ended : mapping of name to JobResult
        How the process of every diagnosis ended, and every cell that could not be drawn.
    """

    words: str
    ended: Mapping[str, JobResult]


def run_trial(
    trials: int,
    seed: int,
    folder: str | Path,
    workers: Workers,
    progress: Callable[[str], None] = lambda text: None,
    *,
    five_axes: bool = False,
) -> TrialResult:
    """Run a blind trial; an interrupted one goes on where it was.

    Parameters
    ----------
    trials : int
        Cells.
    workers : callable(jobs)
        Who draws, diagnoses and judges the cells, see ``fleet.fleet``; the results do not
        depend on it.
    five_axes : bool
        Only cells of machines with rotary axes.
    """
    folder = ensure_folder(folder)
    ended = seal(orders(trials, seed, five_axes=five_axes), folder, workers, progress)
    cells = sorted(p.name for p in (folder / 'cells').iterdir())
    questions = _blind_questions(folder, cells)
    answers, asked = ask_all(questions, folder, read_seal(folder), workers, progress)
    entries = open_key(folder)
    whole = {q.cell: q for q in questions if q.label == WHOLE}
    sized = [e for e in entries if e['parts'] and 'failed' not in answers[WHOLE, e['cell']]]
    sized = [e for e in sized if e['kind'] not in AXIS_KINDS]
    sized = [e for e in sized if all(p['effect'] not in NOISE for p in e['parts'])]
    pairs = [(e, whole[e['cell']]) for e in sized]
    recovered, judged = _recover_all(pairs, folder, workers, progress)
    text = _score(
        folder, entries, answers, list(recovered.values()), FIVE_AXES if five_axes else ''
    )
    write_text(folder / 'score.txt', text + '\n')
    return TrialResult(text, {**ended, **asked, **judged})


def run_leave_one_out(
    trials: int,
    seed: int,
    folder: str | Path,
    workers: Workers,
    progress: Callable[[str], None] = lambda text: None,
) -> TrialResult:
    """Diagnose runs with their effect and its kin taken out of the catalogue; as ``run_trial``.

    What is taken out is taken out in every form.
    """
    folder = ensure_folder(folder)
    ended = seal(orders(trials, seed, leave_one_out=True), folder, workers, progress)
    entries = open_key(folder)
    questions = [
        Question(e['cell'], ('bag',), kin_of(e['parts'][0]['effect']), WITHOUT) for e in entries
    ]
    answers, asked = ask_all(questions, folder, read_seal(folder), workers, progress)
    outcomes: list[Outcome] = []
    named = []
    for entry, question in zip(entries, questions, strict=True):
        outcomes.append(outcome(entry, answers[WITHOUT, entry['cell']], question.exclude))
        if outcomes[-1].named:
            named.append((entry, question))
    recovered, judged = _recover_all(named, folder, workers, progress)
    main, *rest = leave_one_out_table(outcomes, recovered)
    data = score_to_dict(outcomes, list(recovered.values()))
    _publish(folder, data, main, option=LEAVE_ONE_OUT)
    text = '\n\n'.join(map(as_text, [main, *rest]))
    write_text(folder / 'score.txt', text + '\n')
    return TrialResult(text, {**ended, **asked, **judged})

# SPDX-License-Identifier: Apache-2.0
"""What the terminal shows of a calibration: a dozen lines of its document."""

from __future__ import annotations

from otf_core.files.message_text import shortened
from otf_core.model.expanded import COVERAGE_FACTOR, micro_figure, micro_with_expanded
from otf_core.model.motions import unit_of
from otf_core.prediction.calibration_document import CalibrationDocument

CONTRIBUTORS, WARNINGS, WIDTH = 4, 2, 240
"""Contributions and warnings that are named, and letters of a warning."""


def calibration_summary(document: CalibrationDocument) -> str:
    """Return the lines of a terminal; values to two digits of u."""
    machine, first, fit = document.machine, document.headline, document.fit
    if first is None or document.verdicts is None or fit is None:
        return f'{machine.name}, chain {machine.chain}: tables of {len(document.motions)} motions'
    mean = first.expanded['mean']
    parts = list(first.contributions.items())[:CONTRIBUTORS]
    before, after = (
        micro_figure(v, fit.path_mae_after) for v in (fit.path_mae_before, fit.path_mae_after)
    )
    lines = [
        f'{machine.name}, chain {machine.chain}, run {document.run_id}',
        *document.verdicts.words,
        *first.sentences,
        'largest contributions, each alone, rms over the volume: '
        + ', '.join(f'{name} {micro_figure(size, mean)}' for name, size in parts),
        *(
            f'{kind}: {", ".join(_scalar(document, name) for name in own)}'
            for kind, own in (('squareness', document.squareness), ('location', document.location))
            if own
        ),
        f'distance from the path: mean {before} before, {after} after compensation, on the run '
        f'itself',
    ]
    bound = document.target_offset_bound
    if bound is not None and bound.contains:
        lines.append(bound.sentence)
    if needs := unseen_words(document):
        lines.append(f'not determined, zero in the tables: {"; ".join(needs)}')
    if document.effects_sentence:
        lines.append(document.effects_sentence)
    typical = document.typical_systematic  # the headline says it already
    warnings = [w for w in document.warnings if not typical or w != typical.sentence]
    lines += [f'warning: {shortened(w, WIDTH)}' for w in warnings[:WARNINGS]]
    if (more := len(warnings) - WARNINGS) > 0:
        lines.append(f'warning: {more} more in report.html')
    return '\n'.join(lines)


def unseen_words(document: CalibrationDocument) -> list[str]:
    """Errors that the data do not show and what would show them, those of one need together.

    Without the rotations that the sentence on the target offset names already.
    """
    bound, by_need = document.target_offset_bound, dict[str, list[str]]()
    named = {r for own in bound.contains.values() for r in own} if bound else set()
    for name in document.not_identifiable:
        if name not in named:
            scalar = document.squareness.get(name) or document.location.get(name)
            needs = scalar.needs if scalar else document.motions[name].needs
            by_need.setdefault(needs or '', []).append(name)
    return [', '.join(names) + (f' (needs {n})' if n else '') for n, names in by_need.items()]


def _scalar(document: CalibrationDocument, name: str) -> str:
    own = document.squareness.get(name) or document.location[name]
    if not own.identifiable:
        return f'{name} not known'
    k = COVERAGE_FACTOR if own.k is None else own.k
    return f'{name} {micro_with_expanded(own.value, k * own.u, unit_of(name))}'

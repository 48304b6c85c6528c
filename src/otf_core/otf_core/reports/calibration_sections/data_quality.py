# SPDX-License-Identifier: Apache-2.0
"""What became of the samples: gaps, outliers, excluded, repeated, clock."""

from __future__ import annotations

from otf_core.model.provenance import moment
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.section import Section, Table

NO_DATE = 'the stamps tell no date: they count from some other start'


def section(facts: Facts) -> Section:
    """Return the section."""
    rows, data = [], []
    for number, run in enumerate(facts.result.runs, start=1):
        pieces, lost = run.pieces, run.lost
        rest = run.samples - pieces.used - pieces.outliers
        rows.append(
            (
                f'{number} {run.name}'.strip(),
                str(run.samples),
                str(pieces.used),
                str(pieces.outliers),
                str(rest),
                str(lost.samples),
                str(lost.gaps),
                f'{lost.longest:.3f}',
                f'{run.rate:.1f}',
            )
        )
        sizes = {'lost': lost.samples, 'gaps': lost.gaps, 'longest_gap': lost.longest}
        data.append({'run': run.name, 'samples': run.samples, 'used': pieces.used,
                     'outliers': pieces.outliers, 'excluded': rest, 'rate': run.rate,
                     **sizes})  # fmt: skip
    head = ('Run', 'Samples', 'Used', 'Outliers', 'Excluded', 'Missing by the stamps', 'Gaps',
            'Longest (s)', 'Rate (Hz)')  # fmt: skip
    clocks = tuple(
        f'Clock of {o.name or "the run"}: '
        + (f'{moment(o.first_ns)} to {moment(o.last_ns)}' if moment(o.first_ns) else NO_DATE)
        + f', {(o.last_ns - o.first_ns) * 1e-9:.3f} s.'
        for o in facts.result.origin
    )
    words = (
        'Excluded: at standstill, near corners and off the path. Repeated samples and those '
        'without a beam are dropped while a recording is read, before they are counted here.',
        *_read(facts),
        *clocks,
    )
    table = Table(head, tuple(rows), numbers=tuple(range(1, 9)))
    return Section('data', 'Data quality', words, {'runs': data}, (table,))


def _read(facts: Facts) -> tuple[str, ...]:
    """What was repaired or left out while recordings were read."""
    said = [f'While reading {run.name or "the run"}: {remark}.'
            for run in facts.result.runs for remark in run.remarks]  # fmt: skip
    return tuple(said) or ('While reading nothing was repaired or left out.',)

# SPDX-License-Identifier: Apache-2.0
"""Certificate of a calibration: two pages of A4 that a customer signs for and files."""

from __future__ import annotations

from otf_core.calibration.verdict import WHAT
from otf_core.model.circumstances import CERTIFICATE, INSTRUMENT, NUMBERS, TEXTS
from otf_core.model.expanded import figure, significant, with_expanded
from otf_core.model.limits import UNCERTAINTY, VOLUMETRIC
from otf_core.model.motions import SQUARENESS, ErrorMotion
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.calibration_pictures import (
    BOUND,
    ErrorSize,
    bound_words,
    error_sizes,
    volume_pictures,
)
from otf_core.reports.calibration_sections.error_motions import role
from otf_core.reports.calibration_sections.first_screen import MOODS, badges, running_words
from otf_core.reports.condition_tables import measured
from otf_core.reports.drawing.scene import SCRIPT
from otf_core.reports.page import Heading, page_html
from otf_core.reports.section import Cell, Picture, Section, State, Table
from otf_core.reports.wording import micro_unit, place

BLANK = '\N{HORIZONTAL ELLIPSIS}' * 10
"""To be filled in by hand."""
BY_HAND = ('number', 'customer', 'laboratory', 'operator', 'place')
"""What a certificate leaves room for where machine.yaml does not state it."""
HASH_LETTERS = 16
"""Letters of a hash that identify a recording on paper; the whole one is in error_tables.json."""
NAMED_RECORDINGS = 3
"""Recordings that are named."""
BETWEEN = {'C0Y': 'X and Y', 'B0Z': 'X and Z', 'A0Z': 'Y and Z'}


def certificate_html(facts: Facts) -> str:
    """Return the certificate as a page that prints on two sheets of A4."""
    number = facts.machine.stated.certificate.get('number')
    name = f'certificate {number}, ' if number else ''
    heading = Heading(
        f'Calibration certificate{f" {number}" if number else ""}',
        '',
        badges(facts.result.verdicts),
        running=f'{name}{running_words(facts)}',
    )
    sections = [_subject(facts), _volume(facts), _errors(facts), _statement(facts), _signatures()]
    return page_html(heading, sections)


def _subject(facts: Facts) -> Section:
    stated, machine = facts.machine.stated, facts.machine
    ranges = ', '.join(
        f'{a} {1e3 * axis.min:g} to {1e3 * axis.max:g}' for a, axis in machine.axes.items()
    )
    runs = facts.result.runs
    given = {**stated.certificate, **stated.conditions}
    words = {**CERTIFICATE, **{k: TEXTS[k] for k in ('operator', 'place')}}
    parties = [
        (said, str(given.get(key, BLANK)))
        for key, said in words.items()
        if key in given or key in BY_HAND
    ]
    subject = (
        ('machine', f'{machine.name}, chain {machine.chain}'),
        ('calibrated volume', f'{ranges} mm'),
        ('target offset', '; '.join(dict.fromkeys(place(run.target_offset) for run in runs))),
        ('measured', measured(facts.result.origin) or 'the stamps hold no date'),
    )
    own = stated.instrument
    instrument = [
        (said, own.get(key, 'not stated'))
        for key, said in INSTRUMENT.items()
        if key in own or key in ('model', 'serial')
    ]
    conditions = [
        (said, f'{given[key]:g} {unit}')
        for key, (said, unit, _, _) in NUMBERS.items()
        if key in given
    ]
    if 'remark' in stated.conditions:
        conditions.append((TEXTS['remark'], str(stated.conditions['remark'])))
    tables = tuple(
        Table(('', ''), tuple(rows), title=title)
        for title, rows in (
            ('Customer and place', parties),
            ('Machine', subject),
            ('Instrument: laser tracker', instrument),
            ('Conditions', conditions or [('not stated', '')]),
        )
    )
    return Section('subject', '', tables=tables)


def _volume(facts: Facts) -> Section:
    first = facts.result.headline
    rows = (
        ('as the machine stands', figure(1e6 * first.error['mean'], 1e6 * first.expanded['mean']),
         with_expanded(1e6 * first.error['max'], 1e6 * first.of_largest)),
        ('expected after compensation with these tables: U, predicted, not measured',
         *(significant(1e6 * first.expanded[s]) for s in ('mean', 'max'))),
    )  # fmt: skip
    head = ('Length of the error vector (um)', 'Mean', 'Largest')
    picture = volume_pictures(facts)
    still = Picture(picture.parts, 'Error vectors (left) and U of the vector as radius (right) at '
                    'one scale.', picture.columns, key=picture.key)  # fmt: skip
    return Section('certificate-volume', 'Volume before and after compensation', (),
                   tables=(Table(head, rows, numbers=(1, 2)),), draw=lambda: (still,),
                   script=SCRIPT)  # fmt: skip


def _errors(facts: Facts) -> Section:
    rows: list[tuple[Cell, ...]] = [_volume_limit(facts, name) for name in _volume_limits(facts)]
    rows += [_row(facts, one) for one in error_sizes(facts)]
    head = ('Error', 'Is', 'Value', 'U', 'Unit', 'Limit', 'State')
    table = Table(head, tuple(rows), numbers=(2, 3, 5), stacked=True)
    return Section('certificate-errors', 'All 21 errors', tables=(table,))


def _volume_limits(facts: Facts) -> list[str]:
    limits = facts.machine.limits
    return [n for n in (VOLUMETRIC, UNCERTAINTY) if limits and n in limits.values]


def _volume_limit(facts: Facts, name: str) -> tuple[Cell, ...]:
    verdict = facts.result.machine_verdict
    assert verdict is not None, 'limits are stated'
    one = next(j for j in verdict.judged if j.name == name)
    wide = significant(1e6 * one.U) if one.U else ''
    value = figure(1e6 * one.value, 1e6 * (one.U or one.value))
    return ('volume', WHAT[name], value, wide, micro_unit(one.unit), f'{1e6 * one.limit:g}',
            State(one.state, MOODS[one.state]))  # fmt: skip


def _row(facts: Facts, one: ErrorSize) -> tuple[Cell, ...]:
    limit: Cell = '' if one.limit is None else f'{1e6 * one.limit:g}'
    state: Cell = State(one.state, MOODS[one.state]) if one.state else ''
    if one.name in SQUARENESS:
        said, value = f'squareness of {BETWEEN[one.name]}', facts.tables.squareness[one.name].value
    else:
        motion = ErrorMotion.of(one.name)
        said, value = f'{role(motion)} of {motion.axis}, span', one.value
    name = f'{one.name}{BOUND}' if one.bound else one.name
    if not one.known:
        return name, said, 'not known', '', '', limit, state
    wide = 1e6 * one.U
    return (name, said, figure(1e6 * value, wide), significant(wide), micro_unit(one.unit),
            limit, state)  # fmt: skip


def _statement(facts: Facts) -> Section:
    first, about = facts.result.headline, facts.provenance
    words = [
        f'U is the expanded uncertainty by JCGM 100 (GUM): the combined standard uncertainty '
        f'times the coverage factor k = {first.k:.3g}, which covers about 95 %; where 60 or fewer '
        f"degrees of freedom stand behind it, k is Student's t. U holds noise and misfit of the "
        f'measurement and {first.label}.',
        'A limit is kept if value + U is at most the limit and broken if value - U is above it '
        '(ISO 14253-1). Errors are actual minus nominal position of the target relative to the '
        'table, names after ISO 230-1; the volumetric error is that of a regular grid, the best '
        'rigid motion taken out. Results hold at the time, the target offset and the conditions '
        'of the measurement and are not reduced to 20 °C.',
    ]
    words.append(bound_words(facts).strip())
    hidden = facts.result.not_identifiable
    if hidden:
        words.append(f'Not known: {", ".join(hidden)}: these data do not show them.')
    runs = about.get('runs', [])
    hashes = [f'{r["name"]} {r["sha256"][:HASH_LETTERS]}'.strip() for r in runs]
    named = ', '.join(hashes[:NAMED_RECORDINGS])
    more = f' and {len(hashes) - NAMED_RECORDINGS} more' if len(hashes) > NAMED_RECORDINGS else ''
    words.append(
        f'Run {facts.result.run_id}, otf_core {about["software"]["version"]}, written '
        f'{about["written"]}; SHA-256 of the recording begins: {named}{more}. '
        f'All values, covariances and whole hashes: error_tables.json.'
    )
    said = tuple(line for line in words if line)
    return Section('statement', 'Uncertainty and traceability', said)


def _signatures() -> Section:
    lines = ''.join(f'<div>{said}</div>' for said in ('Date', 'Measured by', 'Approved by'))
    part = f'<div class="signatures">{lines}</div>'
    return Section('signatures', '', draw=lambda: (Picture((part,), ''),))

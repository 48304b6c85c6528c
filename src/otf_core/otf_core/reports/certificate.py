# SPDX-License-Identifier: Apache-2.0
"""Certificate of a calibration: pages of A4 that a customer signs for and files."""

from __future__ import annotations

from otf_core.model.expanded import figure, significant, with_expanded
from otf_core.model.machine import TOOL, Machine
from otf_core.model.motions import ErrorMotion
from otf_core.model.sections import (
    CERTIFICATE,
    INSTRUMENT,
    NUMBERS,
    TEXTS,
    UNCERTAINTY,
    VOLUMETRIC,
)
from otf_core.model.tables import ErrorTables
from otf_core.prediction.calibration_document import LIMIT_MEANING, MachineVerdict
from otf_core.reports.calibration_facts import CalibrationFacts, measurement_dates
from otf_core.reports.calibration_sections.error_motions import role
from otf_core.reports.calibration_sections.first_screen import (
    BOUND,
    MOODS,
    ErrorSize,
    badges,
    bound_words,
    error_sizes,
    running_words,
    volume_pictures,
)
from otf_core.reports.drawing.scene import SCRIPT
from otf_core.reports.page import (
    Cell,
    Heading,
    Picture,
    Section,
    State,
    Table,
    micro_unit,
    page_html,
    place,
)

BLANK = '\N{HORIZONTAL ELLIPSIS}' * 10
"""To be filled in by hand."""
BY_HAND = ('number', 'customer', 'laboratory', 'operator', 'place')
"""What a certificate leaves room for where machine.yaml does not state it."""
HASH_LETTERS = 16
"""Letters of a hash that identify a recording on paper; the whole one is in error_tables.json."""
NAMED_RECORDINGS = 3
"""Recordings that are named."""
BETWEEN = {'C0Y': 'X and Y', 'B0Z': 'X and Z', 'A0Z': 'Y and Z'}


def certificate_html(facts: CalibrationFacts) -> str:
    """Return the certificate as a page that prints on few sheets of A4."""
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


def _subject(facts: CalibrationFacts) -> Section:
    machine, stated = facts.machine, facts.machine.stated
    offsets = [run.target_offset for run in facts.result.runs]
    given = {**stated.certificate, **stated.conditions}
    words = {**CERTIFICATE, **{k: TEXTS[k] for k in ('operator', 'place')}}
    parties = [
        (entry, str(given.get(key, BLANK)))
        for key, entry in words.items()
        if key in given or key in BY_HAND
    ]
    subject = (
        ('machine', f'{machine.name}, chain {machine.chain}'),
        ('calibrated volume', _ranges(machine)),
        ('target offset', '; '.join(dict.fromkeys(map(place, offsets)))),
        ('measured', measurement_dates(facts.result.origin) or 'the stamps contain no date'),
    )
    own = stated.instrument
    instrument = [
        (entry, own.get(key, 'not stated'))
        for key, entry in INSTRUMENT.items()
        if key in own or key in ('model', 'serial')
    ]
    conditions = [
        (entry, f'{given[key]:g} {unit}')
        for key, (entry, unit, _, _) in NUMBERS.items()
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


def _ranges(machine: Machine) -> str:
    """Ranges of all axes, mm and degrees."""
    parts: dict[str, list[str]] = {}
    for name, axis in machine.axes.items():
        factor, unit = axis.shown
        words = f'{name} {factor * axis.min:.6g} to {factor * axis.max:.6g}'
        parts.setdefault(unit, []).append(words)
    return '; '.join(f'{", ".join(own)} {unit}' for unit, own in parts.items())


def _volume(facts: CalibrationFacts) -> Section:
    first, picture = facts.result.headline, volume_pictures(facts)
    rows = (
        ('as found', figure(1e6 * first.error['mean'], 1e6 * first.expanded['mean']),
         with_expanded(1e6 * first.error['max'], 1e6 * first.of_largest)),
        ('expected after compensation with these tables: U, predicted, not measured',
         *(significant(1e6 * first.expanded[s]) for s in ('mean', 'max'))),
    )  # fmt: skip
    table = Table(('Length of the error vector (um)', 'Mean', 'Largest'), rows, numbers=(1, 2))
    caption = 'Error vectors (left) and U of the vector as radius (right) at the same scale.'
    still = Picture(picture.parts, caption, picture.columns, key=picture.key)
    return Section('certificate-volume', 'Volume before and after compensation', (),
                   tables=(table,), draw=lambda: (still,), script=SCRIPT)  # fmt: skip


def _errors(facts: CalibrationFacts) -> Section:
    sizes = error_sizes(facts)
    rows = _volume_limits(facts.machine, facts.result.verdicts.machine)
    rows += [_row(facts.tables, one) for one in sizes]
    head = ('Error', 'Is', 'Value', 'U', 'Unit', 'Limit', 'State')
    table = Table(head, tuple(rows), numbers=(2, 3, 5), stacked=True)
    return Section('certificate-errors', f'All {len(sizes)} errors', tables=(table,))


def _volume_limits(machine: Machine, verdict: MachineVerdict) -> list[tuple[Cell, ...]]:
    """Rows of the limits of the volume."""
    if machine.limits is None:
        return []
    rows = list[tuple[Cell, ...]]()
    judged = {one.name: one for one in verdict.limits}
    for name in (VOLUMETRIC, UNCERTAINTY):
        if name in machine.limits.values:
            one = judged[name]
            wide = significant(1e6 * one.U) if one.U else ''
            value = figure(1e6 * one.value, 1e6 * (one.U or one.value))
            rows.append(('volume', LIMIT_MEANING[name], value, wide, micro_unit(one.unit),
                         f'{1e6 * one.limit:g}', State(one.state, MOODS[one.state])))  # fmt: skip
    return rows


def _row(tables: ErrorTables, one: ErrorSize) -> tuple[Cell, ...]:
    limit: Cell = '' if one.limit is None else f'{1e6 * one.limit:g}'
    state: Cell = State(one.state, MOODS[one.state]) if one.state else ''
    if one.name in tables.machine.scalars:
        label, value = _scalar_label(one.name), tables.scalar(one.name)
    else:
        motion = ErrorMotion.of(one.name)
        label, value = f'{role(motion)} of {motion.axis}, span', one.value
    name = f'{one.name}{BOUND}' if one.bound else one.name
    if not one.known:
        return name, label, 'not known', '', '', limit, state
    wide = 1e6 * one.U
    return (name, label, figure(1e6 * value, wide), significant(wide), micro_unit(one.unit),
            limit, state)  # fmt: skip


def _scalar_label(name: str) -> str:
    if name in BETWEEN:
        return f'squareness of {BETWEEN[name]}'
    what = 'offset of the line' if name[0] in 'XYZ' else 'orientation of the line'
    about = f'in {name[0]}' if name[0] in 'XYZ' else f'about {"XYZ"["ABC".index(name[0])]}'
    return f'{what} of {name[2]} {about}'


def _statement(facts: CalibrationFacts) -> Section:
    """What U holds, how limits are judged, where the values come from."""
    result, about, first = facts.result, facts.provenance, facts.result.headline
    words = [
        f'U is the expanded uncertainty by JCGM 100 (GUM): the combined standard uncertainty '
        f'times the coverage factor k = {first.k:.3g}, which covers about 95 %; where 60 or fewer '
        f"degrees of freedom stand behind it, k is Student's t. U holds noise and misfit of the "
        f'measurement and {first.label}.',
        f'A limit is met if value + U is at most the limit and exceeded if value - U is above it '
        f'(ISO 14253-1). Errors are actual minus nominal position of the target relative to the '
        f'table, names after ISO 230-1; the volumetric error is that of {facts.points}, the best '
        f'rigid motion removed'
        f'. Results apply to the time, the target offset and the conditions of the measurement '
        f'and are not corrected to 20 °C.',
    ]
    words.append(bound_words(facts).strip())
    if facts.tables.location:
        exact = '' if facts.machine.targets[TOOL].u else ', taken to be at its offset exactly'
        words.append(
            f'Lines of rotary axes are stated relative to the target in the spindle{exact}.'
        )
    if result.not_identifiable:
        names = ', '.join(result.not_identifiable)
        words.append(f'Not known: {names}: these data do not determine them.')
    runs = about.get('runs', [])
    hashes = [f'{r["name"]} {r["sha256"][:HASH_LETTERS]}'.strip() for r in runs]
    named = ', '.join(hashes[:NAMED_RECORDINGS])
    more = f' and {len(hashes) - NAMED_RECORDINGS} more' if len(hashes) > NAMED_RECORDINGS else ''
    words.append(
        f'Run {result.run_id}, otf_core {about["software"]["version"]}, written '
        f'{about["written"]}; SHA-256 of the recording begins: {named}{more}. '
        f'All values, covariances and whole hashes: error_tables.json.'
    )
    lines = tuple(line for line in words if line)
    return Section('statement', 'Uncertainty and traceability', lines)


def _signatures() -> Section:
    lines = ''.join(f'<div>{role}</div>' for role in ('Date', 'Measured by', 'Approved by'))
    part = f'<div class="signatures">{lines}</div>'
    return Section('signatures', '', draw=lambda: (Picture((part,), ''),))

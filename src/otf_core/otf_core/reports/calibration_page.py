# SPDX-License-Identifier: Apache-2.0
"""Report and certificate of a calibration: functions of the content of error_tables.json.

What is said stands in the templates; here are the charts, and what has to be worked out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from otf_core.model.expanded import (
    figure,
    micro_unit,
    significant,
)
from otf_core.model.frames import XYZ
from otf_core.model.machine import TOOL
from otf_core.model.motions import ErrorMotion
from otf_core.model.sections import (
    CERTIFICATE,
    INSTRUMENT,
    NUMBERS,
    TEXTS,
    UNCERTAINTY,
    VOLUMETRIC,
)
from otf_core.prediction.calibration_document import FAIL, PASS
from otf_core.reports import calibration_errors as errors
from otf_core.reports import calibration_measurement as measurement
from otf_core.reports.calibration_errors import Content
from otf_core.reports.rendering import State, place, render

BY_HAND = ('number', 'customer', 'laboratory', 'operator', 'place')
"""What a certificate leaves room for where machine.yaml does not state it."""


def calibration_page(doc: Mapping[str, Any]) -> str:
    """Return the report of an error_tables.json."""
    content = Content(doc)
    return render(
        'calibration.html.j2', errors=errors, measurement=measurement, **_shared(content)
    )


def certificate_page(doc: Mapping[str, Any]) -> str:
    """Return the certificate: pages of A4 that a customer signs for and files."""
    content = Content(doc)
    return render('certificate.html.j2', **_shared(content), **_certified(content))


def calibration_pages(doc: Mapping[str, Any]) -> dict[str, str]:
    """Return report and, where machine.yaml has a section ``certificate``, certificate."""
    pages = {'report.html': calibration_page(doc)}
    if doc['machine'].get('certificate'):
        pages['certificate.html'] = certificate_page(doc)
    return pages


def calibration_summary(doc: Mapping[str, Any]) -> str:
    """Return the lines of a terminal; the page holds all the rest."""
    content = Content(doc)
    scalars = {
        'squareness': [errors.scalar_words(content, n) for n in doc['squareness']],
        'location': [errors.scalar_words(content, n) for n in doc['location']],
    }
    return render('calibration.txt.j2', d=doc, c=content, scalars=scalars,
                  warnings=errors.warnings(doc), limits=errors.limit_lines(content),
                  needs=errors.needs(content)).rstrip()  # fmt: skip


def _shared(content: Content) -> dict[str, Any]:
    """What report and certificate both show."""
    doc, machine = content.doc, content.machine
    axes = len(machine.axis_names)
    spread = ('points of a regular grid over the driven volume' if axes <= 3
              else 'positions spread over the driven ranges of all axes')  # fmt: skip
    dates = doc['provenance'].get('measured') or {}
    first, last = dates.get('first'), dates.get('last')
    measured = f'{first[:19]}Z to {last[:19]}Z' if first and last else ''
    when = measured or f'written {doc["provenance"]["written"]}'
    arrows, spheres, key = errors.volume_charts(content)
    bound = errors.bound_sentence(doc)
    return {
        'd': doc,
        'c': content,
        'machine': machine,
        'badges': verdict_badges(doc['verdicts']),
        'points': f'{len(content.grid)} {spread}',
        'measured': measured,
        'about': f'{machine.name}, run {doc["run_id"]}, {when}',
        'volume': (arrows, spheres),
        'volume_key': key,
        'offset_bound': f'{errors.BOUND} {bound}.'
        if (bound := errors.bound_sentence(doc))
        else '',
    }


def verdict_badges(verdicts: Mapping[str, Any]) -> tuple[State, State]:
    """One for the measurement, one for the machine."""
    good, machine = verdicts['measurement']['good'], verdicts['machine']
    measured = (
        State('measurement: good', 'good') if good else State('measurement: not good', 'bad')
    )
    if not machine['limits']:
        return measured, State('machine: no limits stated')
    mood = {PASS: 'good', FAIL: 'bad'}.get(machine['state'], 'open')
    return measured, State(machine['sentence'].partition(' (')[0], mood)


# The certificate.


def _certified(content: Content) -> dict[str, Any]:
    """Tables of the certificate."""
    machine, stated = content.machine, content.machine.stated
    given = {**stated.certificate, **stated.conditions}
    entries = {**CERTIFICATE, **{k: TEXTS[k] for k in ('operator', 'place')}}
    blank = '\N{HORIZONTAL ELLIPSIS}' * 10  # to be filled in by hand
    ranges: dict[str, list[str]] = {}
    for name, axis in machine.axes.items():
        factor, unit = axis.shown
        said = f'{name} {factor * axis.min:.6g} to {factor * axis.max:.6g}'
        ranges.setdefault(unit, []).append(said)
    conditions = [(entry, f'{given[key]:g} {unit}') for key, (entry, unit, _, _) in
                  NUMBERS.items() if key in given]  # fmt: skip
    if 'remark' in stated.conditions:
        conditions.append((TEXTS['remark'], str(stated.conditions['remark'])))
    return {
        'number': stated.certificate.get('number'),
        'parties': [(entry, str(given.get(key, blank))) for key, entry in entries.items()
                    if key in given or key in BY_HAND],
        'ranges': '; '.join(f'{", ".join(own)} {unit}' for unit, own in ranges.items()),
        'offsets': '; '.join(dict.fromkeys(place(r['target_offset']) for r in
                                           content.doc['runs'])),
        'instrument': [(entry, stated.instrument.get(key, 'not stated')) for key, entry in
                       INSTRUMENT.items() if key in stated.instrument
                       or key in ('model', 'serial')],
        'conditions': conditions or [('not stated', '')],
        'rows': [*_volume_limit_rows(content), *(certified_row(content, n) for n in
                                                 content.doc['sizes'])],
        'exact': bool(content.doc['location']) and not machine.targets[TOOL].u,
    }  # fmt: skip


def _volume_limit_rows(content: Content) -> Iterator[tuple[Any, ...]]:
    for name in (VOLUMETRIC, UNCERTAINTY):
        if name in content.limits:
            what, value, wide, limit, unit, state = errors.limit_row(content.limits[name])
            yield ('volume', what, value, wide, unit, limit, state)


def certified_row(content: Content, name: str) -> tuple[Any, ...]:
    """Error, what it is, value, U, unit, limit and state."""
    own, limit = content.doc['sizes'][name], errors.limit_of(content, name)
    state = content.limits.get(name, {}).get('state')
    end = (
        '' if limit is None else f'{1e6 * limit:g}',
        State(state, errors.MOODS[state]) if state else '',
    )
    if name in content.machine.scalars:
        between = {'C0Y': 'X and Y', 'B0Z': 'X and Z', 'A0Z': 'Y and Z'}.get(name)
        line = (f'offset of the line of {name[2]} in {name[0]}' if name[0] in 'XYZ' else
                f'orientation of the line of {name[2]} about '
                f'{XYZ["ABC".index(name[0])]}')  # fmt: skip
        what, value = (
            f'squareness of {between}' if between else line,
            content.entries[name]['value'],
        )
    else:
        motion = ErrorMotion.of(name)
        what, value = f'{errors.role(motion)} of {motion.axis}, span', own['size']
    if own['size'] is None:
        return (name, what, 'not known', '', '', *end)
    wide = 1e6 * own['k'] * own['u']
    return (errors.starred(content, name), what, figure(1e6 * value, wide), significant(wide),
            micro_unit(own['unit']), *end)  # fmt: skip

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
from otf_core.model.machine import SPINDLE, TOOL
from otf_core.model.motions import DIRECTIONS, ErrorMotion
from otf_core.model.sections import (
    CERTIFICATE,
    INSTRUMENT,
    NUMBERS,
    TEXTS,
    UNCERTAINTY,
    VOLUMETRIC,
)
from otf_core.prediction.calibration_document import FAIL, PASS
from otf_core.reports.calibration_errors import (
    BOUND,
    DRAWN_RUNS,
    MOODS,
    Content,
    bound_sentence,
    component_charts,
    error_bars,
    iso_row,
    lag_words,
    largest_motions,
    limit_key,
    limit_lines,
    limit_of,
    limit_row,
    location_words,
    motion_chart,
    motion_row,
    needs,
    node_rows,
    radial_motion,
    reversal_row,
    role,
    scalar_words,
    squareness_row,
    starred,
    target_row,
    turns_chart,
    volume_charts,
    warnings,
    why_reversal,
)
from otf_core.reports.calibration_measurement import (
    budget_charts,
    chance_of_fit,
    condition_number,
    correlation_chart,
    coverage_chart,
    coverage_row,
    drift_charts,
    drift_row,
    drifting,
    leg_charts,
    noise_times,
    quantity_row,
    reference_words,
    repeat_command,
    run_tables,
    source_rows,
    stated_tables,
    track_chart,
    used_sources,
    worst_combination,
)
from otf_core.reports.charts import (
    Bar,
    bars,
)
from otf_core.reports.rendering import State, micro, place, render

BY_HAND = ('number', 'customer', 'laboratory', 'operator', 'place')
"""What a certificate leaves room for where machine.yaml does not state it."""


def calibration_page(doc: Mapping[str, Any]) -> str:
    """Return the report of an error_tables.json."""
    content = Content(doc)
    return render('calibration.html.j2', **_shared(content), **_whole(content))


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
        'squareness': [scalar_words(content, n) for n in doc['squareness']],
        'location': [scalar_words(content, n) for n in doc['location']],
    }
    return render('calibration.txt.j2', d=doc, c=content, scalars=scalars,
                  warnings=warnings(doc), limits=limit_lines(content),
                  needs=needs(content)).rstrip()  # fmt: skip


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
    arrows, spheres, key = volume_charts(content)
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
        'offset_bound': f'{BOUND} {bound}.' if (bound := bound_sentence(doc)) else '',
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


def _whole(content: Content) -> dict[str, Any]:
    """Charts and tables of the report."""
    doc = content.doc
    share, members = worst_combination(content)
    return {
        'error_bars': error_bars(content),
        'error_key': limit_key(content),
        'needs': needs(content),
        'warnings': warnings(doc),
        'largest': list(largest_motions(content)),
        'motion_rows': [motion_row(content, m) for m in map(str, content.machine.motions)],
        'motion_charts': {a: [motion_chart(content, ErrorMotion(d, a)) for d in DIRECTIONS]
                          for a in content.machine.axes},
        'radial': {a: radial_motion(content, a) for a, own in content.machine.axes.items()
                   if own.rotary and len(content.entries[f'E{a}{a}']['position']) > 1},
        'squareness': {n: squareness_row(content, n) for n in doc['squareness']},
        'location': [location_words(content, n) for n in doc['location']],
        'exact_targets': [n for n in doc['targets'] if content.machine.targets[n].link == SPINDLE
                          and content.machine.targets[n].u == 0.0],
        'target_rows': [target_row(content, n) for n in doc['targets']],
        'limit_rows': [limit_row(one) for one in content.limits.values()],
        'component_charts': component_charts(content),
        'alone_chart': bars(
            [Bar(n, ((1e6 * v, 'before'),), f'{micro(v)} µm') for n, v in content.alone[:12]],
            'contribution of each motion'),
        'turns': turns_chart(doc['turns']) if doc['turns'] else None,
        'late': list(lag_words(doc)),
        'why_reversal': list(why_reversal(doc['reversal']['evidence'])),
        'iso_rows': [iso_row(content, a) for a in content.machine.axes],
        'reversal_rows': [reversal_row(n, own) for n, own in doc['reversal']['motions'].items()],
        'source_rows': list(source_rows(content)),
        'quantity_head': (sources := used_sources(doc)),
        'quantity_rows': [quantity_row(n, own, sources) for n, own in
                          doc['budget']['u_rms'].items()],
        'budget_charts': budget_charts(doc),
        'source_keys': [(f's{k}', n) for k, n in enumerate(sources)],
        'worst_share': share, 'worst_members': members,
        'correlation_chart': correlation_chart(content),
        'stated': stated_tables(content.machine),
        'run_tables': run_tables(doc),
        'reference': reference_words(content),
        'tracks': [track_chart(content, run) for run in doc['runs'][:DRAWN_RUNS]],
        'leg_charts': [leg_charts(run) for run in doc['runs'][:DRAWN_RUNS]],
        'coverage_rows': [coverage_row(content, a) for a in content.machine.axes],
        'coverage_charts': [coverage_chart(content, a) for a in content.machine.axes],
        'drift_rows': [drift_row(n, run) for n, run in enumerate(doc['runs'], start=1)],
        'drifting': list(drifting(doc['runs'])),
        'drift_charts': drift_charts(doc['runs'][0]),
        'condition': condition_number(content.covariance),
        'chance': chance_of_fit(doc),
        'noise_times': noise_times(doc['runs']),
        'node_tables': {m: list(node_rows(content, m)) for m in map(str, content.machine.motions)},
        'repeat': repeat_command(doc),
        'settings': doc['config'],
    }  # fmt: skip


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
            what, value, wide, limit, unit, state = limit_row(content.limits[name])
            yield ('volume', what, value, wide, unit, limit, state)


def certified_row(content: Content, name: str) -> tuple[Any, ...]:
    """Error, what it is, value, U, unit, limit and state."""
    own, limit = content.doc['sizes'][name], limit_of(content, name)
    state = content.limits.get(name, {}).get('state')
    end = (
        '' if limit is None else f'{1e6 * limit:g}',
        State(state, MOODS[state]) if state else '',
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
        what, value = f'{role(motion)} of {motion.axis}, span', own['size']
    if own['size'] is None:
        return (name, what, 'not known', '', '', *end)
    wide = 1e6 * own['k'] * own['u']
    return (starred(content, name), what, figure(1e6 * value, wide), significant(wide),
            micro_unit(own['unit']), *end)  # fmt: skip

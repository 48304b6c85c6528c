# SPDX-License-Identifier: Apache-2.0
"""Report of a diagnosis: one HTML file that needs nothing else and is read in a minute."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from otf_core.diagnosis.result import Diagnosis, Gap, NamedCause
from otf_core.errors import ConfigError
from otf_core.files.writing import write_text
from otf_core.reports.gap_figures import figures
from otf_core.reports.gap_words import (
    VERDICTS,
    confidence_words,
    effect_cause,
    effect_name,
    next_measurements,
    quantity,
    shown_parameters,
    text,
)
from otf_core.reports.style import STYLE

TITLE = 'Gap between run and simulation'


def _bar(
    label: str,
    value: float,
    top: float,
    colour: str,
    ends: tuple[float, float] | None = None,
) -> str:
    width = 100.0 * value / top
    mark = ''
    if ends is not None:
        low, high = (100.0 * max(0.0, min(e, top)) / top for e in ends)
        place = f'left:{low:.1f}%;width:{max(high - low, 0.3):.1f}%'
        mark = f'<div class="range" style="{place}"></div>'
    return (
        f'<span>{label}</span><div class="track"><div class="fill" '
        f'style="width:{width:.1f}%;background:var(--{colour})"></div>{mark}</div>'
        f'<span>{value:.2f} µm</span>'
    )


def _gap_section(gap: Gap, causes: bool) -> str:
    low, high = (gap.before_um * (1.0 - s / 100.0) for s in reversed(gap.shrink_interval_percent))
    top = max(gap.measured_um, gap.simulated_um, gap.before_um, gap.after_um, high, 1e-6)
    bars = [
        _bar('Residual of the run', gap.measured_um, top, 'noise'),
        _bar('Residual of its simulation', gap.simulated_um, top, 'noise'),
        _bar('Gap before', gap.before_um, top, 'before'),
    ]
    note = ''
    if causes:
        bars.append(_bar('Gap after', gap.after_um, top, 'after', (low, high)))
        a, b = gap.shrink_interval_percent
        note = (
            f'<p>With the causes added to the simulation the gap shrinks by '
            f'<b>{gap.shrink_percent:.0f} %</b> (95 % interval {a:.0f} % to {b:.0f} %), judged on '
            f'legs that the causes were not fitted to.</p>'
        )
    return (
        f'<div class="bars">{"".join(bars)}</div>{note}'
        '<p class="soft">Residual: distance of the aligned, compensated measurement across the '
        'path, root mean square over path pieces. Gap: square root of measured squared minus '
        'simulated squared.</p>'
    )


def _parameters(cause: NamedCause) -> str:
    names, more = shown_parameters(cause)
    rows = ''.join(
        f'<tr><td>{text(n)}</td><td>'
        f'{quantity(cause.parameters[n], cause.u.get(n), cause.units.get(n, ""))}</td></tr>'
        for n in names
    )
    rest = f'<div class="soft">and {more} more in gap.json</div>' if more else ''
    return f'<table>{rows}</table>{rest}' if rows else ''


def _cause_row(rank: int, cause: NamedCause) -> str:
    about = effect_cause(cause.effect)
    rivals = ' or '.join(effect_name(r) for r in cause.indistinguishable_from)
    cells = (
        f'<td>{rank}</td>',
        f'<td><b>{effect_name(cause.effect)}</b>',
        f'<div class="soft">{about}</div>' if about else '',
        f'<div>In these data not told from: <b>{rivals}</b></div>' if rivals else '',
        f'</td><td class="short">{text(", ".join(cause.axes)) or "–"}</td>',
        f'<td>{_parameters(cause)}</td>',
        f'<td class="number">{cause.before_um:.2f} → {cause.after_um:.2f}',
        f'<div class="soft">shrinks by {cause.shrink_percent:.0f} %</div></td>',
        f'<td class="words">{text(confidence_words(cause.confidence))}</td>',
    )
    return f'<tr>{"".join(cells)}</tr>'


def _causes_section(diagnosis: Diagnosis) -> str:
    if not diagnosis.causes:
        reason = {
            'none': 'None: the run shows no more than its simulation.',
            'unknown': 'None named: no effect of the catalogue explains the gap. '
            f'Its structure: {text(diagnosis.unexplained_where)}.',
        }.get(diagnosis.verdict, 'None found.')
        return f'<p>{reason}</p>'
    rows = ''.join(_cause_row(k, c) for k, c in enumerate(diagnosis.causes, start=1))
    changed = (
        f'<p>With the causes in the calibration the error tables change the predicted volumetric '
        f'error by {diagnosis.table_change_um:.2f} µm on average over the volume.</p>'
        if diagnosis.table_change_um > 0
        else ''
    )
    return (
        '<table><thead><tr><th></th><th>Cause</th><th>Axes</th><th>Parameters (± U, k = 2)</th>'
        f'<th class="number">Gap (µm)</th><th>Confidence</th></tr></thead><tbody>{rows}</tbody>'
        f'</table>{changed}'
    )


def _figures_section(diagnosis: Diagnosis) -> str:
    try:
        return figures(diagnosis.shown.views, bool(diagnosis.causes))
    except ConfigError as error:
        return f'<p class="soft">No pictures: {text(error)}</p>'


def _unexplained_section(diagnosis: Diagnosis) -> str:
    where = text(diagnosis.unexplained_where)
    return (
        f'<p><b>{diagnosis.unexplained_um:.2f} µm</b> (root mean square)'
        + (f': {where}.' if where else '.')
        + '</p>'
    )


def _hidden_section(diagnosis: Diagnosis) -> str:
    if not diagnosis.not_visible:
        return '<p>Every effect of the catalogue would have left a trace in these data.</p>'
    rows = ''.join(
        f'<tr><td>{effect_name(e)}<div class="soft">{effect_cause(e)}</div></td>'
        f'<td>{text(needs)}</td></tr>'
        for e, needs in diagnosis.not_visible
    )
    return (
        '<p>These effects leave no trace in these data, so they are neither found nor absent.</p>'
        '<table class="halves"><thead><tr><th>Effect</th><th>Shown by</th></tr></thead>'
        f'<tbody>{rows}</tbody></table>'
    )


def _list(lines: Sequence[str], empty: str) -> str:
    if not lines:
        return f'<p>{empty}</p>'
    return f'<ul>{"".join(f"<li>{text(line)}</li>" for line in lines)}</ul>'


def _version() -> str:
    try:
        return version('otf_core')
    except PackageNotFoundError:
        return 'not installed, run from source'


def _conditions_section(diagnosis: Diagnosis) -> str:
    first = {'runs': ', '.join(diagnosis.runs), 'otf_core': _version()}
    items = first | dict(diagnosis.shown.conditions)
    rows = ''.join(f'<tr><th>{text(k)}</th><td>{text(v)}</td></tr>' for k, v in items.items())
    return f'<table><tbody>{rows}</tbody></table>'


def report_html(diagnosis: Diagnosis) -> str:
    """Return the report as HTML."""
    causes = bool(diagnosis.causes)
    verdict = VERDICTS.get(diagnosis.verdict, diagnosis.verdict)
    sections = (
        ('', _gap_section(diagnosis.gap, causes)),
        ('Causes', _causes_section(diagnosis)),
        ('Where it lies', f'<p>{text(diagnosis.where.summary)}</p>'),
        ('What stays unexplained', _unexplained_section(diagnosis)),
        ('What these data cannot show', _hidden_section(diagnosis)),
        (
            'What to measure next',
            _list(next_measurements(diagnosis), 'Nothing more is needed for this question.'),
        ),
        ('Pictures', _figures_section(diagnosis)),
        ('Conditions', _conditions_section(diagnosis)),
    )
    body = '\n'.join(
        f'<section>{f"<h2>{title}</h2>" if title else ""}{content}</section>'
        for title, content in sections
    )
    runs = text(', '.join(diagnosis.runs))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{TITLE}: {runs}</title><style>{STYLE}</style></head><body>\n'
        f'<h1>{TITLE} · {runs}<span class="badge">{text(verdict)}</span></h1>'
        f'<p class="verdict">{text(diagnosis.sentence)}</p>\n{body}\n</body></html>\n'
    )


def write_report(diagnosis: Diagnosis, path: str | Path) -> None:
    """Write the report, whole or not at all."""
    write_text(path, report_html(diagnosis))

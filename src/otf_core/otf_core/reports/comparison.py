# SPDX-License-Identifier: Apache-2.0
"""What ``otf compare`` writes: page, comparison.json, text.

Figures are one for each motion (paper Figures 6 to 8) and one of the volume (Figure 9).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.compare import COVERAGE_FACTOR, Comparison, agreement
from otf_core.files.writing import ensure_folder
from otf_core.model.evaluation import mean_length
from otf_core.model.frames import XYZ
from otf_core.model.motions import unit_of
from otf_core.model.provenance import provenance
from otf_core.reports.charts import (
    LEVELS,
    Bar,
    Panel,
    Scale,
    bars,
    heat_classes,
    heat_key,
    heat_step,
    scale_around,
)
from otf_core.reports.scene import Item, Strokes, box, magnification, scene
from otf_core.reports.rendering import escaped as text
from otf_core.reports.page import (
    Heading,
    Picture,
    Section,
    State,
    Table,
    micro,
    micro_unit,
    page_html,
    place,
    table_to_text,
    write_result,
)

HISTOGRAM_BINS = 31
ARROW_SHARE = 0.12
"""Length of the longest arrow, share of the longest edge."""
MOST_ARROWS = 343
"""About; of more points only some are drawn."""
BANDS = f'Bands: U (k = {COVERAGE_FACTOR:g}), pointwise.'
AGREEING_SHARE = 0.95
"""Share of normalised errors up to 1 from which two sources agree: that of their coverage."""
ROW_WORDS = (
    'a and b: span of an error motion, value of any other error, both in the same gauge; U: '
    'largest, k = 2; E_n: difference over the root of the sum of both U squared'
)
SCHEMA = 'otf-comparison/2'
CONVENTION = (
    'positioning and rotations zero at axis position 0, else at the common minimum; straightness '
    'zero at both ends of the common range; squareness contains what this removes from them'
)
LINES = 'location errors contain the least-squares line of the motions of rotary axes'


def _convention(result: Comparison) -> str:
    return f'{CONVENTION}; {LINES}' if result.common.machine.location else CONVENTION


def _along(result: Comparison, name: str) -> tuple[Array, str]:
    """Positions of a motion as they are shown, and their unit."""
    turns = result.common.machine.axes[name[-1]].rotary
    scale, unit = (np.degrees(1.0), 'deg') if turns else (1e3, 'mm')
    return scale * result.errors[name].position, unit


def motion_panel(result: Comparison, name: str, *, difference: bool = False) -> str:
    """One motion of both sides, or their difference, with U as bands."""
    pair, k = result.errors[name], 1e6 * COVERAGE_FACTOR
    sides = [(1e6 * pair.a, k * pair.u_a, 'after'), (1e6 * pair.b, k * pair.u_b, 'before')]
    if difference:
        wide = k * np.hypot(pair.u_a, pair.u_b)
        sides = [(0.0 * wide, wide, 'noise'), (1e6 * pair.difference, 0.0 * wide, 'ink')]
    reach = [e for value, wide, _ in sides for e in (value - wide, value + wide)]
    (x, unit), label = _along(result, name), f'{name}, b - a' if difference else name
    micro_name = micro_unit(unit_of(name)).replace('u', '\N{MICRO SIGN}', 1)
    scale = scale_around(np.concatenate(reach), f'{label} ({micro_name})')
    panel = Panel(Scale(float(x[0]), float(x[-1]), f'{name[-1]} ({unit})'), scale)
    marks = [panel.band(x, v - w, v + w, f'{kind} band') for v, w, kind in sides if kind != 'ink']
    marks += [panel.line(x, v, kind) for v, _, kind in sides if kind != 'noise']
    if difference:
        marks += [panel.level(0.0, 'soft'), panel.dots(x, 1e6 * pair.difference, 'ink')]
    return panel.draw(marks, f'{label} of both', label)


def difference_histogram(values: Array, reach: float, axis: str) -> str:
    """Differences (n,), um, along an axis, on a scale up to ``reach``."""
    edges = np.linspace(-1.02 * reach, 1.02 * reach, HISTOGRAM_BINS + 1)
    share = 100.0 * np.histogram(values, edges)[0] / len(values)
    panel = Panel(
        Scale(-1.02 * reach, 1.02 * reach, f'b - a along {axis} (µm)'),
        scale_around(share, 'share of points (%)', zero=True),
    )
    heading = f'along {axis}: standard deviation {values.std():.2f} µm'
    marks = [panel.columns(edges, share, 'noise')]
    return panel.draw(marks, f'difference along {axis}', heading)


def _vectors(result: Comparison) -> tuple[str, str]:
    """Differences in the volume, coloured by length in classes, and the key of the colours."""
    step = max(1, len(result.volume.position) // MOST_ARROWS)
    points, field = result.volume.position[::step], result.volume.difference[::step]
    low, high = points.min(axis=0), points.max(axis=0)
    length = np.linalg.norm(field, axis=1)
    shown = magnification(float(length.max()), ARROW_SHARE * float((high - low).max()))
    size = heat_step(1e6 * length)
    classes = heat_classes(1e6 * length, size)
    items: list[Item] = box(low, high)
    for level in range(LEVELS):
        own = classes == level
        if own.any():
            ends = np.stack([points[own], points[own] + shown.factor * field[own]], axis=1)
            items.append(Strokes(f'heat thin h{level}', ends, arrows=True))
    drawn = scene(items, low, high, 'error vectors in the volume', turns=False, shown=shown)
    return drawn, heat_key(size, 1e6 * float(length.max()), 'µm')


def _known(normalised: Array) -> Array:
    return np.asarray(normalised[np.isfinite(normalised)])


def comparison_html(result: Comparison, date: str) -> str:
    """Return the page; ``date`` says when this was written."""
    words = f'{_convention(result)}.'
    words = words[:1].upper() + words[1:]
    sections = [
        _overview_section(result),
        Section('errors', 'Error by error', (f'{ROW_WORDS}.',), tables=(_table(result),)),
        Section('motions', 'Error motions of both', (words,),
                draw=lambda: _motion_pictures(result)),
        Section('volume', 'Differences in the volume', draw=lambda: _volume_pictures(result)),
    ]  # fmt: skip
    return page_html(_comparison_heading(result, date), sections)


def _comparison_heading(result: Comparison, date: str) -> Heading:
    a, b = result.names
    normalised = _known(np.concatenate([p.normalised for p in result.errors.values()]))
    sizes = _sizes(result)
    what = 'mean length of the difference; rigid motion removed'
    tiles = [
        (f'a: {a}', f'{micro(sizes["mae_a"])} um', 'mean error in the volume'),
        (f'b: {b}', f'{micro(sizes["mae_b"])} um', 'mean error in the volume'),
        ('b - a', f'{micro(sizes["mae_difference"])} um', what),
    ]
    badge = State('no uncertainty stated', 'open')
    sentence = f'They differ by {micro(sizes["mae_difference"])} um on average in the volume.'
    if normalised.size:
        share = agreement(normalised)
        good = share >= AGREEING_SHARE
        badge = State('agree within U', 'good') if good else State('differ beyond U', 'bad')
        sentence += (
            f' {100 * share:.0f} % of the values agree within their expanded uncertainties '
            f'(E_n up to 1), the largest E_n is {normalised.max():.2f}.'
        )
        tiles.append(('E_n up to 1', f'{100 * share:.0f} %', f'of {normalised.size} values'))
    title, machine = f'Comparison of {a} and {b}', result.common.machine.name
    return Heading(title, sentence, (badge,), tuple(tiles), f'{machine}, {title}, {date}')


def _overview_section(result: Comparison) -> Section:
    def draw() -> Sequence[Picture]:
        arrows, key = _vectors(result)
        rows = [_agreement_bar(n, _known(p.normalised)) for n, p in result.errors.items()]
        what = 'Left: difference b minus a of the error vectors.'
        if not any(row.parts for row in rows):
            return [Picture((arrows,), what, key=key)]
        caption = f'{what} Right: largest E_n of each error; stroke: 1, the limit of agreement.'
        return [Picture((arrows, bars(rows, 'largest E_n', width=480.0)), caption, 2, key=key)]

    words = tuple(f'{line[:1].upper()}{line[1:]}.' for line in remarks_on(result))
    return Section('overview', '', words, draw=draw)


def _agreement_bar(name: str, known: Array) -> Bar:
    if not known.size:
        return Bar(name, (), 'no uncertainty')
    worst = float(known.max())
    kind = 'good' if worst <= 1.0 else 'bad'
    return Bar(name, ((worst, kind),), f'{worst:.2f}', 1.0)


HEAD = ('Error', 'Unit', 'Largest |b - a|', 'at', 'a', 'b', 'U of a', 'U of b', 'Largest E_n',
        'E_n up to 1')  # fmt: skip


def _table(result: Comparison) -> Table:
    """A row of each error."""
    rows: list[tuple[str | State, ...]] = []
    for name, pair in result.errors.items():
        known, difference = _known(pair.normalised), np.abs(pair.difference)
        worst, at = int(difference.argmax()), ''
        if pair.position.size:
            x, unit = _along(result, name)
            at = f'{x[worst]:.{2 if unit == "deg" else 1}f} {unit}'
        sizes = (float(np.ptp(v) if pair.position.size else v[0]) for v in (pair.a, pair.b))
        wide = (COVERAGE_FACTOR * float(u.max()) for u in (pair.u_a, pair.u_b))
        state = State('no uncertainty')
        if known.size:
            share = agreement(known)
            state = State(f'{100 * share:.0f} %', 'good' if share >= AGREEING_SHARE else 'bad')
        rows.append((
            name, micro_unit(unit_of(name)), micro(float(difference[worst])), at,
            *map(micro, sizes), *(micro(u) if u > 0 else '-' for u in wide),
            f'{known.max():.2f}' if known.size else '-', state,
        ))  # fmt: skip
    return Table(HEAD, tuple(rows), numbers=tuple(range(2, 9)), stacked=True)


def _motion_pictures(result: Comparison) -> Sequence[Picture]:
    (a, b), motions = result.names, result.common.motions
    key = ''.join(
        f'<span class="{kind}-key"><span class="key"></span>{text(label)}</span> '
        for kind, label in (('after', f'a: {a}'), ('before', f'b: {b}'))
    )
    legend = f'<p class="soft keys">{key}</p>'
    return [
        Picture(tuple(motion_panel(result, m) for m in motions), BANDS, 3, key=legend),
        Picture(tuple(motion_panel(result, m, difference=True) for m in motions),
                'Line: b minus a; grey: U of the difference.', 3, 'Differences'),
    ]  # fmt: skip


def _volume_pictures(result: Comparison) -> Sequence[Picture]:
    difference = 1e6 * result.volume.difference
    reach = float(np.abs(difference).max()) or 1.0
    panels = tuple(difference_histogram(difference[:, k], reach, XYZ[k]) for k in range(3))
    drawn, key = _vectors(result)
    return [
        Picture(panels, 'Share of points by the difference along X, Y and Z.', 3),
        Picture((drawn,), 'Vectors of the difference, colour by length.', key=key),
    ]


def _number(value: float) -> float | None:
    return None if np.isnan(value) else value


def _sizes(result: Comparison) -> dict[str, float]:
    """Mean lengths of the error vectors of a, of b and of b - a, m."""
    volume = result.volume
    fields = {'a': volume.a, 'b': volume.b, 'difference': volume.difference}
    return {f'mae_{name}': mean_length(field) for name, field in fields.items()}


def comparison_to_dict(result: Comparison) -> dict[str, Any]:
    """Return a comparison as plain data."""
    volume, common = result.volume, result.common
    difference, machine = volume.difference, common.machine
    motions, scalars = {}, {}
    for name, pair in result.errors.items():
        normalised = [_number(float(v)) for v in pair.normalised]
        columns = {'a': pair.a, 'b': pair.b, 'u_a': pair.u_a, 'u_b': pair.u_b}
        if name in common.scalars:
            numbers = {k: float(v[0]) for k, v in columns.items()}
            scalars[name] = {'unit': unit_of(name), **numbers, 'normalised_error': normalised[0]}
            continue
        motions[name] = {
            'unit': unit_of(name),
            'position_unit': machine.axes[name[-1]].unit,
            'position': pair.position.tolist(),
            **{k: v.tolist() for k, v in columns.items()},
            'normalised_error': normalised,
            'largest_difference': float(np.abs(pair.difference).max()),
            'largest_normalised_error': max(_known(pair.normalised).tolist(), default=None),
            'within': _number(agreement(pair.normalised)),
        }
    data: dict[str, Any] = {
        'schema': SCHEMA,
        'a': result.names[0],
        'b': result.names[1],
        'convention': _convention(result),
        'counted_as_translations': list(common.folded),
        'without_uncertainty': list(result.without_u),
        'translations_apart_by': list(common.apart),
        'not_compared': dict(common.not_compared),
        'target_offsets': [offset.tolist() for offset in result.offsets],
        'motions': motions,
        'squareness': {n: v for n, v in scalars.items() if n in machine.squareness},
        'location': {n: v for n, v in scalars.items() if n in machine.location},
        'volume': {
            'points': len(volume.position),
            'holds': list(result.errors),
            **_sizes(result),
            'mean_absolute': dict(zip(XYZ, np.abs(difference).mean(axis=0).tolist(), strict=True)),
            'standard_deviation': dict(zip(XYZ, difference.std(axis=0).tolist(), strict=True)),
            'within': _number(agreement(volume.normalised)),
            'coverage_factor': COVERAGE_FACTOR,
        },
    }
    if set(machine.squareness) <= set(scalars):
        data['volume_with_squareness'] = _sizes(result)
    return data


def format_comparison(result: Comparison) -> str:
    """Return the text for a terminal."""
    a, b = result.names
    volume, sizes = result.volume, _sizes(result)
    share = agreement(volume.normalised)
    within = '-' if np.isnan(share) else f'{100 * share:.0f} %'
    lines = [
        f'a: {a}',
        f'b: {b}',
        f'{_convention(result)}; {ROW_WORDS}.',
        '',
        *table_to_text(_table(result)),
        *remarks_on(result),
        '',
        f'volume, {len(volume.position)} points, without rigid motion: mean error '
        f'a {1e6 * sizes["mae_a"]:.2f} um, b {1e6 * sizes["mae_b"]:.2f} um, '
        f'b - a {1e6 * sizes["mae_difference"]:.2f} um; E_n <= 1 for {within} of the components'
        + (', since neither source states an uncertainty' if within == '-' else ''),
    ]  # fmt: skip
    return '\n'.join(lines)


def remarks_on(result: Comparison) -> list[str]:
    """What has to be known beside the numbers."""
    lines, common = [], result.common
    if common.folded:
        lines.append(
            f'{", ".join(common.folded)}: one source cannot distinguish them from translations; '
            f'treated as such'
        )
    if len(result.without_u) == 1:
        lines.append(f'{result.without_u[0]} states no uncertainty: E_n treats it as exact')
    if common.apart:
        axes = ', '.join(dict.fromkeys(m.axis for m in common.apart))
        lines.append(
            f'WARNING {", ".join(common.apart)}: neither source distinguishes them from '
            f'translations, and the sources measured at different target offsets or places'
            f': the '
            f'translations of {axes}, and squareness, differ by these rotations times the '
            f'difference of the levers, regardless of the machine'
        )
    reasons: dict[str, list[str]] = {}
    for name, reason in common.not_compared.items():
        reasons.setdefault(reason, []).append(name)
    lines += [f'not compared: {", ".join(names)}: {why}' for why, names in reasons.items()]
    own, other = result.offsets
    if not np.array_equal(own, other):
        lines.append(f'both at the target offset of a, {place(own)}; that of b is {place(other)}')
    return lines


def write_comparison(
    result: Comparison, folder: str | Path, about: Mapping[str, Any] | None = None
) -> list[Path]:
    """Write report.html and comparison.json.

    Parameters
    ----------
    about : mapping, optional
        Block ``provenance`` of comparison.json.
    """
    data = comparison_to_dict(result) | {'provenance': about or provenance('compare')}
    page = comparison_html(result, str(data['provenance']['written']))
    return write_result(ensure_folder(folder), 'comparison', page, data)

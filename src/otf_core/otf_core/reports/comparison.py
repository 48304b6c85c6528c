# SPDX-License-Identifier: Apache-2.0
"""What ``otf compare`` writes: figures, page, comparison.json, text.

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
from otf_core.model.motions import DIRECTIONS, ErrorMotion, unit_of
from otf_core.model.provenance import provenance
from otf_core.reports.drawing.panel import (
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
from otf_core.reports.drawing.panel import words as svg_words
from otf_core.reports.drawing.scene import Item, Strokes, box, magnification, scene
from otf_core.reports.drawing.style import text
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
    write_result,
)

HISTOGRAM_BINS = 31
ARROW_SHARE = 0.12
"""Length of the longest arrow, share of the longest edge."""
BANDS = f'Bands: U (k = {COVERAGE_FACTOR:g}), pointwise.'
AGREEING_SHARE = 0.95
"""Share of normalised errors up to 1 from which two sources agree: that of their coverage."""
SCHEMA = 'otf-comparison/1'
CONVENTION = (
    'positioning and rotations zero at axis position 0, else at the common minimum; straightness '
    'zero at both ends of the common range; squareness contains what this removes from them'
)


def motion_panel(comparison: Comparison, motion: ErrorMotion) -> str:
    """One motion of both sides with bands."""
    unit = 'µm' if motion.is_translation else 'µrad'
    pair = comparison.motions.get(motion)
    if pair is None:
        return _empty_panel(motion, unit)
    x, k = 1e3 * pair.position, 1e6 * COVERAGE_FACTOR
    sides = ((1e6 * pair.a, k * pair.u_a, 'after'), (1e6 * pair.b, k * pair.u_b, 'before'))
    reach = [e for value, wide, _ in sides for e in (value - wide, value + wide)]
    panel = Panel(_along(x, motion), scale_around(np.concatenate(reach), f'{motion} ({unit})'))
    marks = [panel.band(x, v - w, v + w, f'{kind} band') for v, w, kind in sides]
    marks += [panel.line(x, v, kind) for v, _, kind in sides]
    return panel.draw(marks, f'{motion} of both', motion)


def difference_panel(comparison: Comparison, motion: ErrorMotion) -> str:
    """Difference of one motion with U of the difference."""
    unit = 'µm' if motion.is_translation else 'µrad'
    pair = comparison.motions.get(motion)
    if pair is None:
        return _empty_panel(motion, unit)
    value = 1e6 * pair.difference
    wide = 1e6 * COVERAGE_FACTOR * np.hypot(pair.u_a, pair.u_b)
    scale = scale_around(np.concatenate([value, wide, -wide]), f'b - a ({unit})')
    x = 1e3 * pair.position
    panel = Panel(_along(x, motion), scale)
    marks = [panel.band(x, -wide, wide, 'noise band'), panel.level(0.0, 'soft'),
             panel.line(x, value, 'ink'), panel.dots(x, value, 'ink')]  # fmt: skip
    return panel.draw(marks, f'difference of {motion}', f'{motion}, b - a')


def _empty_panel(motion: ErrorMotion, unit: str) -> str:
    panel = Panel(Scale(0.1, 0.9, '', marks=1), Scale(-1.0, 1.0, f'{motion} ({unit})', marks=1))
    label = svg_words(190.0, 100.0, 'not determined by both', 'middle soft')
    return panel.draw([label], f'{motion}: not determined by both', motion)


def _along(x: Array, motion: ErrorMotion) -> Scale:
    low, high = float(x[0]), float(x[-1])
    return Scale(low, high if high > low else low + 1.0, f'{motion.axis} (mm)')


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


def vectors(q: Array, field: Array, step: float) -> str:
    """Vectors (n, 3) in the volume of points q, coloured by length in classes of ``step``."""
    low, high = q.min(axis=0), q.max(axis=0)
    length = np.linalg.norm(field, axis=1)
    shown = magnification(float(length.max()), ARROW_SHARE * float((high - low).max()))
    classes = heat_classes(1e6 * length, step)
    items: list[Item] = box(low, high)
    for level in range(LEVELS):
        own = classes == level
        if own.any():
            ends = np.stack([q[own], q[own] + shown.factor * field[own]], axis=1)
            items.append(Strokes(f'heat thin h{level}', ends, arrows=True))
    return scene(items, low, high, 'error vectors in the volume', turns=False, shown=shown)


def all_normalised(result: Comparison) -> Array:
    """E_n of all nodes and squareness errors, those without an uncertainty left out, (n,)."""
    parts = [m.normalised for m in result.motions.values()]
    parts.append(np.array([s.normalised for s in result.squareness.values()]))
    values = np.concatenate(parts)
    return np.asarray(values[np.isfinite(values)])


def comparison_html(result: Comparison, convention: str, remarks: Sequence[str], date: str) -> str:
    """Return the page.

    Parameters
    ----------
    convention : str
        In which both are compared.
    remarks : sequence of str
        What has to be known beside the numbers.
    date : str
        When this was written.
    """
    gauge = (f'{convention[:1].upper()}{convention[1:]}.',)
    sections = [
        _overview_section(result, remarks),
        _errors_section(result),
        Section('motions', 'Error motions of both', gauge,
                draw=lambda: _motion_pictures(result)),
        Section('volume', 'Differences in the volume', draw=lambda: _volume_pictures(result)),
    ]  # fmt: skip
    return page_html(_comparison_heading(result, date), sections)


def _comparison_heading(result: Comparison, date: str) -> Heading:
    a, b = result.names
    normalised, volume = all_normalised(result), result.volume
    mean = micro(mean_length(volume.difference))
    badge = State('no uncertainty stated', 'open')
    tiles = [
        (f'a: {a}', f'{micro(mean_length(volume.a))} um', 'mean error in the volume'),
        (f'b: {b}', f'{micro(mean_length(volume.b))} um', 'mean error in the volume'),
        ('b - a', f'{mean} um', 'mean length of the difference, without squareness'),
    ]
    if volume.squareness is not None:
        mean = micro(volume.squareness[2])
        tiles = [
            (f'a: {a}', f'{micro(volume.squareness[0])} um', 'mean error in the volume'),
            (f'b: {b}', f'{micro(volume.squareness[1])} um', 'mean error in the volume'),
            ('b - a', f'{mean} um', 'mean length of the difference; rigid motion removed'),
        ]
    sentence = f'They differ by {mean} um on average in the volume.'
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


def _overview_section(result: Comparison, remarks: Sequence[str]) -> Section:
    def draw() -> Sequence[Picture]:
        rows = [_agreement_bar(n, m.normalised) for n, m in result.motions.items()]
        rows += [_agreement_bar(n, np.array([s.normalised])) for n, s in result.squareness.items()]
        difference = result.volume.difference
        step = heat_step(1e6 * np.linalg.norm(difference, axis=1))
        key = heat_key(step, 1e6 * float(np.linalg.norm(difference, axis=1).max()), 'µm')
        arrows = vectors(result.volume.q, difference, step)
        what = 'Left: difference b minus a of the error vectors, squareness left out.'
        if not all_normalised(result).size:
            return [Picture((arrows,), what, key=key)]
        caption = f'{what} Right: largest E_n of each error; stroke: 1, the limit of agreement.'
        return [Picture((arrows, bars(rows, 'largest E_n', width=480.0)), caption, 2, key=key)]

    words = tuple(f'{line[:1].upper()}{line[1:]}.' for line in remarks)
    return Section('overview', '', words, draw=draw)


def _agreement_bar(name: str, normalised: Array) -> Bar:
    known = normalised[np.isfinite(normalised)]
    if not known.size:
        return Bar(name, (), 'no uncertainty')
    worst = float(known.max())
    kind = 'good' if worst <= 1.0 else 'bad'
    return Bar(name, ((worst, kind),), f'{worst:.2f}', 1.0)


def _errors_section(result: Comparison) -> Section:
    k, rows = COVERAGE_FACTOR, []
    for name, motion in result.motions.items():
        known = motion.normalised[np.isfinite(motion.normalised)]
        rows.append((
            name, micro_unit(unit_of(name)), micro(float(np.ptp(motion.a))),
            micro(float(np.ptp(motion.b))), micro(float(np.abs(motion.difference).max())),
            _micro_wide(k * float(motion.u_a.max())), _micro_wide(k * float(motion.u_b.max())),
            *_agreement_cells(known),
        ))  # fmt: skip
    for name, one in result.squareness.items():
        normalised = np.array([one.normalised])
        rows.append((
            name, 'urad', micro(one.a), micro(one.b), micro(abs(one.difference)),
            _micro_wide(k * one.u_a), _micro_wide(k * one.u_b),
            *_agreement_cells(normalised[np.isfinite(normalised)]),
        ))  # fmt: skip
    words = (
        'a and b: span of an error motion, value of a squareness error, both in the same gauge; '
        'U: largest, k = 2; E_n: difference over the root of the sum of both U squared.',
    )
    head = ('Error', 'Unit', 'a', 'b', 'Largest |b - a|', 'U of a', 'U of b', 'Largest E_n',
            'E_n up to 1')  # fmt: skip
    table = Table(head, tuple(rows), numbers=tuple(range(2, 8)), stacked=True)
    return Section('errors', 'Error by error', words, tables=(table,))


def _micro_wide(value: float) -> str:
    return micro(value) if value > 0 else '-'


def _agreement_cells(known: Array) -> tuple[str, State]:
    if not known.size:
        return '-', State('no uncertainty')
    share = agreement(known)
    mood = 'good' if share >= AGREEING_SHARE else 'bad'
    return f'{known.max():.2f}', State(f'{100 * share:.0f} %', mood)


def _motion_pictures(result: Comparison) -> Sequence[Picture]:
    axes, a, b = result.common.machine.axis_names, *result.names
    motions = [ErrorMotion(d, axis) for d in DIRECTIONS for axis in axes]
    key = ''.join(
        f'<span class="{kind}-key"><span class="key"></span>{text(label)}</span> '
        for kind, label in (('after', f'a: {a}'), ('before', f'b: {b}'))
    )
    legend = f'<p class="soft keys">{key}</p>'
    return [
        Picture(tuple(motion_panel(result, m) for m in motions), BANDS, 3, key=legend),
        Picture(tuple(difference_panel(result, m) for m in motions),
                'Line: b minus a; grey: U of the difference.', 3, 'Differences'),
    ]  # fmt: skip


def _volume_pictures(result: Comparison) -> Sequence[Picture]:
    difference = 1e6 * result.volume.difference
    reach = float(np.abs(difference).max()) or 1.0
    panels = tuple(difference_histogram(difference[:, k], reach, XYZ[k]) for k in range(3))
    length = np.linalg.norm(result.volume.difference, axis=1)
    step = heat_step(1e6 * length)
    drawn = vectors(result.volume.q, result.volume.difference, step)
    key = heat_key(step, 1e6 * float(length.max()), 'µm')
    return [
        Picture(panels, 'Share of points by the difference along X, Y and Z.', 3),
        Picture((drawn,), 'Vectors of the difference, colour by length.', key=key),
    ]


def _worst_and_share(normalised: Array) -> tuple[str, str]:
    """Largest E_n, and the share up to 1 in percent; dashes where no uncertainty is known."""
    known = normalised[np.isfinite(normalised)]
    if not known.size:
        return '-', '-'
    return f'{known.max():.2f}', f'{100 * agreement(known):.0f} %'


def _number(value: float) -> float | None:
    return None if np.isnan(value) else value


def comparison_to_dict(result: Comparison) -> dict[str, Any]:
    """Return a comparison as plain data."""
    volume = result.volume
    motions = {}
    for name, motion in result.motions.items():
        motions[name] = {
            'unit': unit_of(name),
            'position': motion.position.tolist(),
            'a': motion.a.tolist(),
            'b': motion.b.tolist(),
            'u_a': motion.u_a.tolist(),
            'u_b': motion.u_b.tolist(),
            'normalised_error': [_number(float(v)) for v in motion.normalised],
            'largest_difference': float(np.abs(motion.difference).max()),
            'within': _number(agreement(motion.normalised)),
        }
    difference = volume.difference
    squareness = {
        name: {'unit': 'rad', 'a': one.a, 'b': one.b, 'u_a': one.u_a, 'u_b': one.u_b,
               'normalised_error': _number(one.normalised)}
        for name, one in result.squareness.items()
    }  # fmt: skip
    data: dict[str, Any] = {
        'schema': SCHEMA,
        'a': result.names[0],
        'b': result.names[1],
        'convention': CONVENTION,
        'counted_as_translations': list(result.common.folded),
        'without_uncertainty': list(result.without_u),
        'translations_apart_by': list(result.common.apart),
        'target_offsets': [offset.tolist() for offset in result.offsets],
        'motions': motions,
        'squareness': squareness,
        'volume': {
            'points': len(volume.q),
            'mae_a': mean_length(volume.a),
            'mae_b': mean_length(volume.b),
            'mae_difference': mean_length(difference),
            'mean_absolute': dict(zip(XYZ, np.abs(difference).mean(axis=0).tolist(), strict=True)),
            'standard_deviation': dict(zip(XYZ, difference.std(axis=0).tolist(), strict=True)),
            'within': _number(agreement(volume.normalised)),
            'coverage_factor': COVERAGE_FACTOR,
        },
    }
    if volume.squareness is not None:
        keys = ('mae_a', 'mae_b', 'mae_difference')
        data['volume_with_squareness'] = dict(zip(keys, volume.squareness, strict=True))
    return data


def format_comparison(result: Comparison) -> str:
    """Return the text for a terminal."""
    a, b = result.names
    lines = [
        f'a: {a}',
        f'b: {b}',
        f'{CONVENTION}.',
        '',
        'motion  unit   largest |b - a|   rms b - a   mean u_a   mean u_b   largest E_n  E_n <= 1',
    ]
    for name, motion in result.motions.items():
        rms = float(np.sqrt(np.mean(motion.difference**2)))
        worst, share = _worst_and_share(motion.normalised)
        lines.append(
            f'{name:<8}{"um" if unit_of(name) == "m" else "urad":<5}'
            f'{1e6 * np.abs(motion.difference).max():>17.2f}{1e6 * rms:>12.2f}'
            f'{1e6 * motion.u_a.mean():>11.2f}{1e6 * motion.u_b.mean():>11.2f}'
            f'{worst:>14}{share:>11}'
        )
    for name, one in result.squareness.items():
        worst, share = _worst_and_share(np.array([one.normalised]))
        lines.append(
            f'{name:<8}{"urad":<5}{1e6 * abs(one.difference):>17.2f}'
            f'{1e6 * abs(one.difference):>12.2f}{1e6 * one.u_a:>11.2f}{1e6 * one.u_b:>11.2f}'
            f'{worst:>14}{share:>11}'
        )
    lines += remarks_on(result)
    volume = result.volume
    within = _worst_and_share(volume.normalised)[1]
    lines += [
        '',
        f'volume, {len(volume.q)} points: mean error a {1e6 * mean_length(volume.a):.2f} um, '
        f'b {1e6 * mean_length(volume.b):.2f} um, '
        f'b - a {1e6 * mean_length(volume.difference):.2f} um; '
        f'E_n <= 1 for {within} of the components'
        + (', since neither source states an uncertainty' if within == '-' else ''),
    ]
    if volume.squareness is not None:
        lines.append(
            'with squareness, without rigid motion: a {:.2f} um, b {:.2f} um, '
            'b - a {:.2f} um'.format(*(1e6 * v for v in volume.squareness))
        )
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
    if not result.squareness:
        lines.append('squareness is not compared: not determined by both')
    own, other = result.offsets
    if result.volume.squareness is not None and not np.array_equal(own, other):
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
    folder = ensure_folder(folder)
    data = comparison_to_dict(result) | {'provenance': about or provenance('compare')}
    date = str(data['provenance']['written'])
    page = comparison_html(result, CONVENTION, remarks_on(result), date)
    return write_result(folder, 'comparison', page, data)

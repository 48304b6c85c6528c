# SPDX-License-Identifier: Apache-2.0
"""Figures of the gap report with their captions."""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.diagnosis.place.views import RunView
from otf_core.reports.gap_words import text

MOST_RUNS = 3
"""Runs whose residual is drawn against time."""


def _figure(svg: str, caption: str) -> str:
    return f'<figure>{svg}<figcaption>{caption}</figcaption></figure>'


def figures(views: Sequence[RunView], causes: bool) -> str:
    """All figures as HTML.

    Parameters
    ----------
    views : sequence of RunView
    causes : bool
        Show the residual with the causes too.

    Raises
    ------
    ConfigError
        If matplotlib is not installed.
    """
    from otf_core.reports.plots.gap_groups import draw_beam, draw_frequency, draw_travel
    from otf_core.reports.plots.gap_place import draw_place
    from otf_core.reports.plots.gap_time import draw_time
    from otf_core.reports.plots.inline import inline_svg

    parts = ['<h3>Against time</h3>']
    for number, view in enumerate(views[:MOST_RUNS]):
        run = f' Run {text(view.name)}.' if len(views) > 1 else ''
        caption = (
            'One dot a leg: root mean square of the residual, and its mean along the machine '
            f'axes, of legs across that axis.{run}'
        )
        svg = inline_svg(draw_time(view, causes), f'time{number}', 'residual against time')
        parts.append(_figure(svg, caption))
    if len(views) > MOST_RUNS:
        parts.append(f'<p class="soft">{len(views) - MOST_RUNS} further runs are not drawn.</p>')
    drawn = (
        ('In the volume', 'place', draw_place, 'The volume seen along Z, Y and X: colour is the '
         'root mean square of the residual, arrows its mean, in cells of the view.'),
        ('By line, feed and sense of travel', 'travel', draw_travel, 'Diagonals are named after '
         'the axes they move; forward is towards larger axis positions.'),
        ('By beam', 'beam', draw_beam, 'Length of the beam, its azimuth about machine Z (from '
         '+X) and its elevation over the XY plane.'),
        ('By frequency', 'frequency', draw_frequency, 'Within legs: along time, and along the '
         'position of each axis on the legs that move it. The point at the slow end holds all '
         'that is slower, means of legs included; means over path pieces hide what is shorter '
         'than two pieces.'),
    )  # fmt: skip
    for title, name, draw, caption in drawn:
        svg = inline_svg(draw(views, causes), name, title.lower())
        parts.append(f'<h3>{title}</h3>{_figure(svg, caption)}')
    return '\n'.join(parts)

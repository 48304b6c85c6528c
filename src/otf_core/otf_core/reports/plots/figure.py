# SPDX-License-Identifier: Apache-2.0
"""Empty figures and whole files of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from otf_core.errors import ConfigError
from otf_core.files.writing import whole_file

COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9')
"""Told apart by colour-blind readers too (Okabe and Ito 2008)."""


def new_figure(width: float, height: float) -> Any:
    """Return an empty matplotlib figure, inches, without any display behind it.

    Raises
    ------
    ConfigError
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ConfigError(f'figures need matplotlib: {error}') from None
    return Figure(figsize=(width, height), layout='constrained')


def save_figure(figure: Any, folder: str | Path, name: str) -> Path:
    """Write a figure as SVG, whole or not at all; the same figure gives the same bytes."""
    import matplotlib

    path = Path(folder) / f'{name}.svg'
    settings: Any = {'svg.hashsalt': name, 'svg.fonttype': 'none'}
    with matplotlib.rc_context(settings), whole_file(path) as partial:
        figure.savefig(partial, format='svg', metadata={'Date': None})
    return path

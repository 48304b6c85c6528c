# SPDX-License-Identifier: Apache-2.0
"""A result in an interactive session: one line, a short table, a data frame, a figure.

pandas and matplotlib are used where they are installed, and needed for nothing else.
"""

from __future__ import annotations

import html
import math
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from otf_core.budget.budget import Budget
from otf_core.errors import ConfigError
from otf_core.files.writing import tidy
from otf_core.model.expanded import micro_with_expanded
from otf_core.model.motions import MOTIONS, SQUARENESS, unit_of
from otf_core.model.tables import ErrorTables
from otf_core.prediction.volumetric import table_places

if TYPE_CHECKING:
    from otf_core.calibration.result import CalibrationResult


COLUMNS = (
    'error', 'axis', 'position', 'value', 'unit', 'u', 'identifiable', 'U', 'k', 'U_with_typical',
    'target_offset',
)  # fmt: skip
WIDTH, HEIGHT = 2.6, 2.2
"""inch; of a panel of the figure."""


def _optional(module: str, needs: str) -> Any:
    """A module that the package does without; ConfigError if it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        name = module.partition('.')[0]
        raise ConfigError(
            f'{needs} needs the package {name}, which is not installed: pip install {name}'
        ) from None


def coverage_factors(tables: ErrorTables, budget: Budget) -> dict[str, float]:
    """Coverage factor of every motion and squareness error; NaN where nothing is known."""
    variances, found = budget.variances(), {}
    for name, part in table_places(tables).items():
        own = variances[:, part]
        known = own[:, own.sum(axis=0) > 0]
        found[name] = budget.expansion(known)[0] if known.size else math.nan
    return found


def one_line(result: CalibrationResult) -> str:
    """Machine, both verdicts, error and expanded uncertainty."""
    head, verdicts = result.headline, result.verdicts
    words = (verdicts.measurement_words, verdicts.machine_words)
    return (
        f'<CalibrationResult {result.tables.machine.name}: {head.error_words}; '
        f'{head.expanded_words}; {"; ".join(words)}>'
    )


def table_html(result: CalibrationResult) -> str:
    """The same as rows, and squareness; what else there is in a line."""
    head, verdicts = result.headline, result.verdicts
    lines = [*head.words[:2], verdicts.measurement_words, verdicts.machine_words]
    rows = []
    for name in SQUARENESS:
        value, wide = result.tables.squareness[name].value, float(result.expanded[name][0])
        seen = name not in result.not_identifiable
        shown = micro_with_expanded(value, wide, 'rad') if seen else 'not seen'
        bound = result.offset_bound.words(name)
        rows.append((f'squareness {name}', f'{shown}, {bound}' if bound else shown))
    unseen = [n for n in result.not_identifiable if n not in SQUARENESS]
    if unseen:
        rows.append(('not seen', ', '.join(unseen)))
    offset = ', '.join(f'{1e3 * v:.1f}' for v in result.tables.machine.target_offset)
    rows.append(('target offset', f'({offset}) mm'))
    cells = ''.join(f'<tr><th>{_typeset(a)}</th><td>{_typeset(b)}</td></tr>' for a, b in rows)
    words = '<br>'.join(map(_typeset, lines))
    return (
        f'<p><b>{_typeset(result.tables.machine.name)}</b><br>{words}</p><table>{cells}</table>'
        '<p>All errors: <code>to_frame()</code>, <code>plot()</code></p>'
    )


def _typeset(text: str) -> str:
    """Escaped for HTML, with proper signs."""
    plain = text.replace('+/-', '±').replace(' um', ' µm').replace(' urad', ' µrad')
    return html.escape(plain)


def data_frame(result: CalibrationResult) -> Any:
    """All nodes and squareness errors, a row each; see ``CalibrationResult.to_frame``."""
    module = _optional('pandas', 'CalibrationResult.to_frame()')
    tables, rows = result.tables, list[tuple[Any, ...]]()
    factors = coverage_factors(tables, result.budget)
    for motion in MOTIONS:
        table, k = tables.motions[motion], factors[motion]
        known = table.node_identifiable
        flags = np.ones(len(table.position), bool) if known is None else known
        rows += [
            (
                str(motion),
                motion.axis,
                tidy(p),
                v,
                motion.unit,
                u,
                bool(seen),
                _expanded(k, u),
                k,
                float(whole),
                _offset(result, motion),
            )
            for p, v, u, seen, whole in zip(
                table.position, table.value, table.u, flags, result.expanded[motion], strict=True
            )
        ]
    for name in SQUARENESS:
        entry, k = tables.squareness[name], factors[name]
        seen = name not in result.not_identifiable
        wide, whole = _expanded(k, entry.u), float(result.expanded[name][0])
        rows.append((name, '', math.nan, entry.value, 'rad', entry.u, seen, wide, k, whole,
                     _offset(result, name)))  # fmt: skip
    frame = module.DataFrame(rows, columns=list(COLUMNS))
    frame.attrs = {
        'machine': tables.machine.name,
        'chain': tables.machine.chain,
        'target_offset': tables.machine.target_offset.tolist(),
        'run_id': result.run_id,
    }
    return frame


def _offset(result: CalibrationResult, name: str) -> tuple[float, ...] | None:
    """Target offset at which alone a value holds, m; None: at any."""
    bound = result.offset_bound
    return tuple(map(float, bound.offset)) if name in bound.contains else None


def _expanded(k: float, u: float) -> float:
    return k * u if u > 0.0 else 0.0


def figure(result: CalibrationResult) -> Any:
    """All error motions over the position, with bands; see ``CalibrationResult.plot``."""
    pyplot = _optional('matplotlib.pyplot', 'CalibrationResult.plot()')
    tables = result.tables
    names = tables.machine.axis_names
    drawn, panels = pyplot.subplots(
        len(names),
        6,
        figsize=(6 * WIDTH, len(names) * HEIGHT),
        squeeze=False,
        layout='constrained',
    )
    for row, axis in zip(panels, names, strict=True):
        for panel, motion in zip(row, (m for m in MOTIONS if m.axis == axis), strict=True):
            table = tables.motions[motion]
            panel.set_title(str(motion), fontsize='medium')
            panel.set_xlabel(f'{axis} (mm)')
            panel.set_ylabel('µm' if unit_of(motion) == 'm' else 'µrad')
            if not table.identifiable:
                panel.set(xticks=[], yticks=[])
                panel.text(0.5, 0.5, 'not seen', ha='center', transform=panel.transAxes)
                continue
            wide = result.expanded[motion]
            low, high = 1e6 * (table.value - wide), 1e6 * (table.value + wide)
            panel.fill_between(1e3 * table.position, low, high, alpha=0.3, linewidth=0)
            panel.plot(1e3 * table.position, 1e6 * table.value, marker='o', markersize=3)
            panel.grid(alpha=0.3)
    label = result.headline.label
    drawn.suptitle(f'{tables.machine.name}: error motions with U ({label})', fontsize='medium')
    return drawn

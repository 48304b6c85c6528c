# SPDX-License-Identifier: Apache-2.0
"""Reversal of a calibration as plain data, CSV rows and text.

Sign: reversal value = error in forward travel (towards larger positions) less error in backward
travel, as ISO 230-2 takes the difference of the means of the two directions of approach; forward
and backward are the mean of the error table plus and minus half of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from otf_core.arrays import Array
from otf_core.files.csv_points import tidy
from otf_core.model.motions import ErrorMotion, unit_of
from otf_core.model.tables import ErrorTables
from otf_core.solving.reversal import MODELS, Reversal

CSV_HEADER = 'motion,axis,position,forward,backward,value,unit,u,identifiable'


def _directions(
    reversal: Reversal, tables: ErrorTables
) -> Iterator[tuple[str, Array, Array, bool]]:
    for name, table in reversal.motions.items():
        mean = tables.motions[name].value
        forward, backward = mean + 0.5 * table.value, mean - 0.5 * table.value
        yield name, forward, backward, table.identifiable


def reversal_to_dict(reversal: Reversal, tables: ErrorTables) -> dict[str, Any]:
    """Return a reversal model as plain data for error_tables.json."""
    motions = {}
    for name, forward, backward, seen in _directions(reversal, tables):
        table = reversal.motions[name]
        motions[name] = {
            'axis': ErrorMotion.of(name).axis,
            'unit': unit_of(name),
            'position': table.position.tolist(),
            'forward': forward.tolist(),
            'backward': backward.tolist(),
            'value': table.value.tolist(),
            'u': table.u.tolist(),
            'identifiable': seen,
        }
    return {
        'model': reversal.model,
        'evidence': dict(reversal.evidence),
        'held': reversal.held,
        'sign': 'value = forward less backward; forward: towards larger positions',
        'axes': {
            axis: {'value': found.value, 'u': found.u} for axis, found in reversal.backlash.items()
        },
        'motions': motions,
    }


def reversal_csv(reversal: Reversal, tables: ErrorTables) -> str:
    """Return reversal.csv: one row a node; the header alone without a reversal model."""
    lines = [CSV_HEADER]
    for name, forward, backward, seen in _directions(reversal, tables):
        table = reversal.motions[name]
        for row in zip(table.position, forward, backward, table.value, table.u, strict=True):
            position, ahead, back, value, u = map(float, row)
            lines.append(
                f'{name},{ErrorMotion.of(name).axis},{tidy(position)!r},{ahead!r},{back!r},{value!r},'
                f'{unit_of(name)},{u!r},{str(seen).lower()}'
            )
    return '\n'.join(lines) + '\n'


def _why(reversal: Reversal) -> list[str]:
    evidence = reversal.evidence
    if 'lines' not in evidence or 'needed' not in evidence:
        decided = evidence.get('decided_by')
        return [f'  decided by {decided}'] if decided else []
    lines = []
    for model in MODELS:
        if f'gain_{model}' in evidence:
            gain, scatter = evidence[f'gain_{model}'], evidence[f'scatter_{model}']
            lines.append(
                f'  {model}: gain over the best simpler model on {evidence["lines"]} held-out '
                f'lines {gain:.1f} +/- {scatter:.1f}; {evidence["needed"]:g} times the scatter is '
                f'needed'
            )
    if 'rival' in evidence:
        lines.append(
            f'  but {evidence["rival"]} explains these legs better: an error that flips with '
            f'travel and grows with the feed; see otf diagnose'
        )
    return lines


def backlash_words(reversal: Reversal) -> str:
    """Reversal value of every axis at the target, with its expanded uncertainty."""
    if not reversal.backlash:
        return ''
    sizes = [f'{axis} {found.words}' for axis, found in reversal.backlash.items()]
    return (
        f'backlash at the target (forward less backward, k = 2): {", ".join(sizes)}; on the '
        f'middle line of the axis, rotations that reverse included'
    )


def format_reversal(reversal: Reversal) -> str:
    """Return the reversal model as text."""
    lines = [f'Reversal model: {reversal.model}', *_why(reversal)]
    if not reversal.motions:
        return '\n'.join(lines)
    stays = 'stay on the side of their last travel' if reversal.held else 'lie between both sides'
    lines += [
        f'axes that stand {stays}',
        *filter(None, [backlash_words(reversal)]),
        'reversal value of every motion alone, forward less backward',
        'motion  unit       min       max    mean u, k = 1',
    ]
    for name, table in reversal.motions.items():
        row = f'{name:<8}{"um" if unit_of(name) == "m" else "urad":<6}'
        if table.identifiable:
            row += f'{1e6 * table.value.min():>8.2f}{1e6 * table.value.max():>10.2f}'
            row += f'{1e6 * table.u.mean():>17.2f}'
        else:
            row += ' not identifiable in these data'
        lines.append(row)
    return '\n'.join(lines)

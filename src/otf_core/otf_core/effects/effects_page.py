# SPDX-License-Identifier: Apache-2.0
"""Write docs/effects.md from the catalogue: ``python3 -m otf_core.effects.effects_page FILE``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from otf_core.effects import EVERY, REGISTRY, ROTARY, Effect
from otf_core.effects.base import words_of_effects
from otf_core.effects.state import probe_state
from otf_core.files.message_text import with_micro_sign
from otf_core.files.writing import write_text
from otf_core.model.machine import BED, TABLE, Axis, Chain, Machine, Target, TrackerSpec

LISTED = 18
"""Names that are written out; of longer lists the first and the last."""

INTRODUCTION = """<!-- Generated: python3 -m otf_core.effects.effects_page docs/effects.md -->
# Effects

Effects that make a real cell differ from the rigid-body simulation. Every effect is one function
in `src/otf_core/otf_core/effects/catalogue/` and one entry in `words.yaml` beside it: the only
formula, used by simulation (`./otf simulate --effects effects.yaml`), fit, diagnosis and report.

An effect displaces the measured point, in the machine frame, actual minus nominal: linear in its
coefficients, nonlinear in its shape parameters. Symbols: q axis positions, u positions scaled to
[-1, 1] over the axis range, d unit travel direction, v speed along the path, t time since the
start of the recording, r beam from tracker to target, R, H, V its length, azimuth and zenith
angle, e_R, e_H, e_V unit vectors in the direction of their increase, e_a unit vector of axis a.
Only displacements across the path are visible on the fly.

```yaml
# effects.yaml: any number of effects; coefficients that are left out are zero, SI units
- effect: backlash
  parameters: {B_X: 5.0e-06, B_Z: -2.0e-06}
- effect: cyclic_error
  parameters: {period: 0.01, S_Y: 1.0e-06}
  units: {period: m, S_Y: m}     # optional; checked if given
```

Free forms and empirical effects as entries of such a file:
[diagnosis.md](diagnosis.md#causes-that-follow-no-formula).
"""

OF_ROTARY_AXES = """# Rotary axes

The effects below are those that only machines with rotary axes have. J_a is the displacement of
the target per rad of the angular positioning of axis a, in the frame of the link that carries the
tracker. These machines may also have
{shared}:
coefficients of a rotary axis are in rad there, and those of an axis act in the direction in which
it moves the target.
"""


def _turning_machine() -> Machine:
    chain = Chain.parse('w-C-A-b-Y-X-Z-t')
    axes = {a: Axis(0.0, 0.6, 0.3) for a in 'XYZ'}
    axes['A'] = Axis(-0.5, 1.5, 0.2, direction=(1.0, 0.0, 0.0))
    axes['C'] = Axis(0.0, 6.28, 0.3, direction=(0.0, 0.0, 1.0))
    spec = TrackerSpec(1e-6, 1e-6, link=BED)
    own = {'nest': Target(TABLE, (0.1, 0.0, 0.1), 1e-3)}
    return Machine('', chain, axes, np.zeros(3), spec, stated_targets=own)


def _machine() -> Machine:
    chain = Chain.parse('w-b-X-Y-Z-t')
    axes = {a: Axis(0.0, 0.6, 0.3) for a in chain.axis_names}
    return Machine('', chain, axes, np.zeros(3), TrackerSpec(1e-6, 1e-6))


def _listed(names: Sequence[str]) -> str:
    if len(names) > LISTED:
        names = (*names[:3], '...', names[-1])
    return ', '.join(n if n == '...' else f'`{n}`' for n in names)


def _parameters(effect: Effect) -> str:
    state = probe_state(_turning_machine() if effect.of_rotary_axes else _machine())
    first = next(iter(effect.shapes(state)), dict.fromkeys(effect.shape_names, 1.0))
    shape = {p.name: first[p.name] for p in effect.shape if p.default is None}
    terms = effect.terms(state, effect.complete_shape(shape))
    parts = []
    for unit in dict.fromkeys(terms.units):
        names = [n for n, u in zip(terms.names, terms.units, strict=True) if u == unit]
        parts.append(f'{_listed(names)} ({unit})')
    shaped = [
        f'`{p.name}` ({p.unit or "number"}{"" if p.default is None else ", may be left out"})'
        for p in effect.shape
    ]
    return '; '.join(parts + shaped)


def _free_words(effect: Effect) -> str:
    return '; '.join(f'{f.words} (of {", ".join(f.inputs)})' for f in effect.free)


def _section(effect: Effect) -> str:
    words = effect.words
    rows = (
        ('Displacement', f'`{words.displacement}`'),
        ('Parameters', f'{words.parameters}: {_parameters(effect)}'),
        *([('Free forms', _free_words(effect))] if effect.free else []),
        ('Looks like', words.looks_like),
        ('Shown by', words.shown_by),
        ('Source', words.source),
    )
    return '\n'.join([f'## {effect.name}', '', *(f'- **{k}**: {v}' for k, v in rows), ''])


def catalogue_markdown() -> str:
    """Return the text of docs/effects.md."""
    rows = ['| effect | cause | typical size |', '|---|---|---|']
    words = words_of_effects()
    rows += [f'| [{n}](#{n}) | {words[n].cause} | {words[n].typical_size} |' for n in EVERY]
    sections = [_section(effect) for effect in REGISTRY.values()]
    shared = ', '.join(f'`{n}`' for n, e in REGISTRY.items() if e.any_axes)
    own = [OF_ROTARY_AXES.format(shared=shared), *(_section(e) for e in ROTARY.values())]
    return with_micro_sign('\n'.join([INTRODUCTION, *rows, '', *sections, *own]))


if __name__ == '__main__':
    write_text(Path(sys.argv[1]), catalogue_markdown())

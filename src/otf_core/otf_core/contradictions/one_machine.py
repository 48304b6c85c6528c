# SPDX-License-Identifier: Apache-2.0
"""Runs that are not of one machine: each alone fits, together they do not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.contradictions.quick_model import Model
from otf_core.errors import InputError
from otf_core.pieces.finding import GATE, WARNING, Finding
from otf_core.pieces.runs import Run

WORSE = 1.3
"""Residual together over alone from which on something is said."""
APART = 2.0
"""The same, for a gate."""
DIFFER, CHANGED, OTHER = 0.05, 0.1, 0.3
"""Part of the errors by which runs differ: from which on it is said; they changed; they are of
another machine."""


def check_one_machine(model: Model, alone: Sequence[Model]) -> list[Finding]:
    """Compare the fit of all runs with that of each alone.

    Parameters
    ----------
    model : Model
    alone : sequence of Model
        Of every recording by itself.

    Raises
    ------
    InputError
        If they are clearly of different machines.
    """
    if len(alone) < 2:
        return []
    together = model.fit.ratio
    apart = _joined([m.fit.square for m in alone], [m.fit.freedom for m in alone])
    if together < WORSE * apart:
        return []
    unit = model.fit.rms / together
    extra = unit * np.sqrt(together**2 - apart**2)
    share = extra / max(_errors(model), 1e-12)
    if share < DIFFER:
        return []
    which = _outsider(alone) if len(alone) > 2 else ''
    text = (
        f'each run alone fits to {1e6 * unit * apart:.2f} um, together they fit to '
        f'{1e6 * unit * together:.2f} um{which}'
    )
    if share > OTHER and together > APART * apart:
        raise InputError(
            f'{_names(model.runs)}: {text}: they are not of one machine, or it was changed '
            f'between them (readjusted, crashed, referenced anew); calibrate them one by one'
        )
    grave = share > CHANGED and together > APART * apart
    return [Finding('one machine', GATE if grave else WARNING, (
        f'{text}: the machine changed between the runs (temperature, load, readjustment), a '
        f'target offset is another than stated, or the model lacks something; calibrate them one '
        f'by one and compare'
    ))]  # fmt: skip


def _joined(square: Sequence[float], freedom: Sequence[float]) -> float:
    return float(np.sqrt(sum(square) / max(sum(freedom), 1.0)))


def _errors(model: Model) -> float:
    """What the tables explain, m: weighted like the residual of a row."""
    fit, rows = model.fit, model.rows
    posed = fit.design.usual[:, : 6 * rows.runs]
    whole = rows.deviation.ravel()
    value = np.linalg.lstsq(
        posed * np.sqrt(fit.weight)[:, None],
        whole * np.sqrt(fit.weight),
        rcond=None,
    )[0]
    left = whole - posed @ value
    return float(np.sqrt(fit.weight @ left**2 / fit.weight.sum()))


def _outsider(alone: Sequence[Model]) -> str:
    """Name the run without which the others fit, if there is one."""
    best, name = np.inf, ''
    for k, one in enumerate(alone):
        others = [m for n, m in enumerate(alone) if n != k]
        apart = _joined([m.fit.square for m in others], [m.fit.freedom for m in others])
        ratio = Model.of([r for m in others for r in m.runs]).fit.ratio / apart
        if ratio < best:
            best, name = ratio, one.runs[0].recording.name or f'run {k + 1}'
    return f' (without {name} the others fit)' if best < WORSE else ''


def _names(runs: Sequence[Run]) -> str:
    return ', '.join(r.recording.name or f'run {k}' for k, r in enumerate(runs, start=1))

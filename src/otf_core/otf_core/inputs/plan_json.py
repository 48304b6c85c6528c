# SPDX-License-Identifier: Apache-2.0
"""Reads what ``otf plan`` wrote: plan.json (``otf-plan/1``) with feed of every leg and dwells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError, InputError
from otf_core.files.json_file import read_json
from otf_core.files.writing import refuse_pipe
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan

SCHEMA = 'otf-plan/1'


@dataclass(frozen=True)
class PlanFile:
    """Content of a plan.json.

    Attributes
    ----------
    plan : Plan
    tracker_place : ndarray, shape (3,), m, optional
        Beam origin in the machine frame that the forecast assumed.
    """

    plan: Plan
    tracker_place: Array | None


def looks_like_json(path: str | Path) -> bool:
    """Tell whether a file starts as a JSON object; False if it cannot be read.

    Raises
    ------
    ConfigError
        If it is a pipe.
    """
    refuse_pipe(path)
    try:
        with open(path, 'rb') as file:
            return file.read(64).lstrip(b'\xef\xbb\xbf \t\r\n').startswith(b'{')
    except OSError:
        return False


def _numbers(data: Mapping[str, Any], key: str, shape: tuple[int, ...], where: str) -> Array:
    """Array of a shape, -1 standing for any length; ConfigError names the key."""
    words = ' x '.join('n' if n < 0 else str(n) for n in shape)
    try:
        values = np.array(data[key], dtype=float)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ConfigError(f'{where}: {key}: expected {words} numbers') from None
    fits = values.ndim == len(shape) and all(
        wanted in (-1, n) for wanted, n in zip(shape, values.shape, strict=True)
    )
    if not fits or not np.all(np.isfinite(values)):
        raise ConfigError(f'{where}: {key}: expected {words} finite numbers')
    return values


def read_plan(path: str | Path) -> PlanFile:
    """Read a plan.json.

    Raises
    ------
    ConfigError
        Names the file and what is wrong with it.
    """
    data = read_json(path)
    where = str(path)
    if not isinstance(data, Mapping) or data.get('schema') != SCHEMA:
        raise ConfigError(f"{where}: no plan; expected the schema '{SCHEMA}' of otf plan")
    points = _numbers(data, 'path', (-1, 3), where)
    feed = _numbers(data, 'feed', (len(points) - 1,), where)
    dwell = _numbers(data, 'dwell', (len(points),), where)
    try:
        plan = Plan(NominalPath(points), feed, dwell)
    except InputError as error:
        raise ConfigError(f'{where}: {error}') from None
    assumed = data.get('assumed')
    place = None
    if isinstance(assumed, Mapping) and 'tracker_place' in assumed:
        place = _numbers(assumed, 'tracker_place', (3,), f'{where}: assumed')
    return PlanFile(plan, place)

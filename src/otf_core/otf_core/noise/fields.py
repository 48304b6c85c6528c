# SPDX-License-Identifier: Apache-2.0
"""A noise model as the fields of noise.json, and back.

``u_range``, ``u_angle`` and ``white_range``, ``white_angle`` are standard deviations, of both
angles in the order horizontal, vertical; ``correlation_time`` is one number, or three where range
and angles differ; ``tails`` holds degrees of freedom by quantity.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.errors import ConfigError
from otf_core.files.strict_yaml import read_json, shown
from otf_core.noise.model import QUANTITIES, NoiseComponent, NoiseModel

FREEDOM = 'student_freedom'


def noise_to_fields(noise: NoiseModel) -> dict[str, Any]:
    """Return a noise model in the layout of noise.json."""
    level, white = noise.level.tolist(), noise.white.tolist()
    times = [c.correlation_time for c in noise]
    return {
        'u_range': level[0],
        'u_angle': level[1:],
        'white_range': white[0],
        'white_angle': white[1:],
        'correlation_time': times[0] if len(set(times)) == 1 else times,
        'tails': {n: {FREEDOM: c.dof} for n, c in zip(QUANTITIES, noise, strict=True)},
    }


def noise_from_fields(data: Mapping[str, Any]) -> NoiseModel:
    """Build a noise model from such fields; without ``tails`` it is normal.

    Raises
    ------
    ValueError
        If a value is impossible; KeyError or TypeError if one is missing or no number.
    """
    level = np.array([data['u_range'], *data['u_angle']], dtype=float)
    white = np.array([data['white_range'], *data['white_angle']], dtype=float)
    time = np.array(data['correlation_time'], dtype=float)
    if level.shape != (3,) or white.shape != (3,):
        raise ValueError('u_angle and white_angle are two values each')
    if time.shape not in ((), (3,)):
        raise ValueError('correlation_time is one value, or three')
    if not (np.all(level > 0) and np.all(np.isfinite(level))):
        raise ValueError('levels must be above 0')
    if not np.all((white >= 0) & (white <= level)):
        raise ValueError('the white part lies between 0 and the level')
    if not np.all((time > 0) | ((time == 0) & (white == level))):
        raise ValueError('correlation_time is 0 beside a slow part')
    freedom = [data.get('tails', {}).get(name, {}).get(FREEDOM) for name in QUANTITIES]
    dof = [None if f is None else float(f) for f in freedom]
    if any(f is not None and not f > 2 for f in dof):
        raise ValueError(f'{FREEDOM} must be above 2')
    parts = zip(level, white, np.broadcast_to(time, 3), dof, strict=True)
    return NoiseModel(*(NoiseComponent(float(u), float(w), float(t), f) for u, w, t, f in parts))


def read_noise(path: str | Path) -> NoiseModel:
    """Read a noise.json of ``otf noise``; ConfigError if it is none."""
    try:
        return noise_from_fields(read_json(path))
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise ConfigError(f'{path}: not a noise.json ({shown(error)})') from None

# SPDX-License-Identifier: Apache-2.0
"""Public functions on recorded runs and on tables: calibrate, diagnose, predict."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from otf_core.calibration.calibrate import calibrate_runs
from otf_core.calibration.result import CalibrationResult
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.calibrate_with_effects import calibrate_with_effects
from otf_core.diagnosis.diagnose import diagnose as diagnose_runs
from otf_core.diagnosis.result import Diagnosis
from otf_core.effects import REGISTRY
from otf_core.errors import ConfigError, ShapeError
from otf_core.live.stages import Progress
from otf_core.memory import giving_back
from otf_core.model.tables import ErrorTables, TablesFile, tables_from_dict
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.pieces.standstill_method import prepare_stops
from otf_core.prediction import predict as evaluation
from otf_core.prediction.predict import Prediction
from otf_core.reports.calibration import result_to_dict
from otf_core.sim.twin import twin_recording

Recordings = Recording | Iterable[Recording]

METHODS = {'otf': prepare_runs, 'standstill': prepare_stops}


def calibrate(
    recordings: Recordings,
    *,
    method: str = 'otf',
    effects: str | Path | None = None,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Error tables of a machine with their uncertainties, from one or several runs.

    Parameters
    ----------
    recordings : Recording or iterable of Recording
        Several: runs of one machine from other stations, at other feeds, with other target
        offsets; they are solved as one.
    method : {'otf', 'standstill'}
        On the fly, or from the stops at the corner points alone.
    effects : str or Path, optional
        Effects to take off: 'auto' for those that a diagnosis finds, or an effects.yaml.
    config : CalibrationConfig, optional
    progress : callable(stage, fraction), optional
        Called as work goes on; what it raises ends the work.

    Returns
    -------
    CalibrationResult
        Look at ``failed_gates`` and ``warnings`` before you use the tables.

    Raises
    ------
    InputError
        If samples and path do not belong together or determine nothing.
    ConfigError
        If the runs are of different machines, or an argument is wrong.

    Examples
    --------
    >>> result = otf_core.calibrate(recording)
    >>> result.failed_gates
    ()
    >>> result.fit.samples, result.fit.path_mae_after < 2e-6
    (38280, True)
    >>> table = result.tables.motions['EXX']  # linear positioning error of X
    >>> table.value.shape == table.u.shape == table.position.shape
    True
    """
    runs = _several(recordings)
    if method not in METHODS:
        raise ConfigError(f'method: {method!r} is unknown; possible: {", ".join(METHODS)}')
    with giving_back():
        if effects is None:
            return calibrate_runs(runs, config, progress, METHODS[method])
        done = calibrate_with_effects(runs, str(effects), twin_recording, config, progress, method)
        return done.result


def diagnose(
    recordings: Recordings,
    *,
    exclude: Sequence[str] = (),
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Where and why runs depart from their simulation.

    Parameters
    ----------
    recordings : Recording or iterable of Recording
        Several: runs of one machine, diagnosed as one.
    exclude : sequence of str
        Effects that are not searched for.
    config : CalibrationConfig, optional
    progress : callable(stage, fraction), optional
        Called as work goes on; what it raises ends the work.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        If samples and path do not belong together or determine nothing.
    ConfigError
        If the runs are of different machines, or ``exclude`` names what is no effect.

    Examples
    --------
    >>> diagnosis = otf_core.diagnose(recording)
    >>> diagnosis.verdict, diagnosis.causes
    ('none', ())
    >>> diagnosis.gap.before_um < 0.1
    True
    """
    runs = _several(recordings)
    unknown = [name for name in exclude if name not in REGISTRY]
    if unknown:
        raise ConfigError(f'exclude: {unknown[0]!r}: no effect; known: {", ".join(REGISTRY)}')
    with giving_back():
        return diagnose_runs(runs, twin_recording, exclude, config, progress)


def predict(
    tables: CalibrationResult | TablesFile | ErrorTables | str | Path,
    points: ArrayLike,
    *,
    target_offset: ArrayLike | None = None,
) -> Prediction:
    """Volumetric errors at points: actual minus nominal, with standard uncertainties.

    Parameters
    ----------
    tables : CalibrationResult, TablesFile, ErrorTables, str or Path
        A result, or an error_tables.json, read or not. Tables alone hold no covariance: their
        nodes are taken as independent then.
    points : array_like, shape (n, 3), m
        Programmed axis positions.
    target_offset : array_like, shape (3,), m, optional
        Predict for this one, e.g. a longer tool; as measured if not given.

    Returns
    -------
    Prediction

    Raises
    ------
    ConfigError
        If the tables cannot be read, or points or offset are not of such a machine.
    ShapeError
        If points is not (n, 3).

    Examples
    --------
    >>> there = otf_core.predict(result, [[0.1, 0.1, -0.2], [-0.15, 0.0, -0.1]])
    >>> there.error.shape, there.inside.tolist()
    ((2, 3), [True, True])
    >>> bool((there.u < 3e-6).all())
    True
    """
    q = np.asarray(points, dtype=float)
    if q.ndim != 2 or q.shape[1] != 3:
        raise ShapeError(f'points: expected shape (n, 3), got {q.shape}')
    if not np.all(np.isfinite(q)):
        first = int(np.flatnonzero(~np.isfinite(q).all(axis=1))[0])
        raise ConfigError(f'points: point {first + 1} is not finite')
    offset = None if target_offset is None else np.asarray(target_offset, dtype=float)
    source: TablesFile | str | Path
    if isinstance(tables, CalibrationResult):
        # through the layout of the file, so that a result and its file predict the same
        content = json.loads(json.dumps(result_to_dict(tables)))
        source = tables_from_dict(content, 'result')
    else:
        source = TablesFile(tables) if isinstance(tables, ErrorTables) else tables
    return evaluation.predict(source, q, offset)


def _several(recordings: Recordings) -> list[Recording]:
    if isinstance(recordings, Recording):
        return [recordings]
    runs = list(recordings) if isinstance(recordings, Iterable) else [recordings]
    wrong = [run for run in runs if not isinstance(run, Recording)]
    if wrong:
        raise ConfigError(f'recordings: expected Recording, got {type(wrong[0]).__name__}')
    if not runs:
        raise ConfigError('recordings: none given')
    return runs

# SPDX-License-Identifier: Apache-2.0
"""On-the-fly calibration of machine tools with a laser tracker.

Read a run, calibrate the machine, ask for its errors anywhere in its volume:

    import otf_core

    machine = otf_core.load_machine('machine.yaml')
    recording = otf_core.read_bag('bag', machine)
    result = otf_core.calibrate(recording)
    there = otf_core.predict(result, [[0.1, 0.2, -0.1]])
    print(otf_core.summary(result), there.error, there.u)

Lengths are in m, angles in rad, times in s; an error is actual minus nominal, u a standard
uncertainty (k = 1). The names below are public; every module is loaded when its first name is
used. The command ``otf`` does the same on files.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from otf_core.version import __version__ as __version__

if TYPE_CHECKING:
    from otf_core.api.functions import (
        Simulation,
        calibrate,
        diagnose,
        plan,
        predict,
        read_bag,
        simulate,
        summary,
        write_bag,
        write_calibration,
        write_diagnosis,
        write_plan,
    )
    from otf_core.calibration.calibration_result import CalibrationResult
    from otf_core.config import (
        CalibrationConfig,
        ForecastConfig,
        PlannerConfig,
        SimulationConfig,
    )
    from otf_core.diagnosis.result import Diagnosis
    from otf_core.errors import ConfigError, InputError, OtfError, ShapeError
    from otf_core.inputs.point_pairs import read_point_pairs
    from otf_core.model.evaluation import without_rigid_motion
    from otf_core.model.machine import Machine, load_machine
    from otf_core.model.observation import Samples
    from otf_core.model.path import NominalPath
    from otf_core.model.plan import Plan
    from otf_core.model.tables import ErrorTables
    from otf_core.pieces.point_pairs import PointPairs
    from otf_core.pieces.runs import Recording
    from otf_core.planning.plan_report import PlanReport
    from otf_core.prediction.calibration_document import CalibrationDocument, load_tables
    from otf_core.prediction.predict import Prediction

_HOMES = {
    'api.functions': (
        'Simulation',
        'calibrate',
        'diagnose',
        'plan',
        'predict',
        'read_bag',
        'simulate',
        'summary',
        'write_bag',
        'write_calibration',
        'write_diagnosis',
        'write_plan',
    ),
    'calibration.calibration_result': ('CalibrationResult',),
    'config': ('CalibrationConfig', 'ForecastConfig', 'PlannerConfig', 'SimulationConfig'),
    'diagnosis.result': ('Diagnosis',),
    'errors': ('ConfigError', 'InputError', 'OtfError', 'ShapeError'),
    'inputs.point_pairs': ('read_point_pairs',),
    'model.evaluation': ('without_rigid_motion',),
    'model.machine': ('Machine', 'load_machine'),
    'model.observation': ('Samples',),
    'model.path': ('NominalPath',),
    'model.plan': ('Plan',),
    'model.tables': ('ErrorTables',),
    'pieces.point_pairs': ('PointPairs',),
    'pieces.runs': ('Recording',),
    'planning.plan_report': ('PlanReport',),
    'prediction.calibration_document': ('CalibrationDocument', 'load_tables'),
    'prediction.predict': ('Prediction',),
}
"""Where the public names come from; the imports above say the same to type checkers."""

__all__ = [
    'CalibrationConfig',
    'CalibrationDocument',
    'CalibrationResult',
    'ConfigError',
    'Diagnosis',
    'ErrorTables',
    'ForecastConfig',
    'InputError',
    'Machine',
    'NominalPath',
    'OtfError',
    'Plan',
    'PlanReport',
    'PlannerConfig',
    'PointPairs',
    'Prediction',
    'Recording',
    'Samples',
    'ShapeError',
    'Simulation',
    'SimulationConfig',
    'calibrate',
    'diagnose',
    'load_machine',
    'load_tables',
    'plan',
    'predict',
    'read_bag',
    'read_point_pairs',
    'simulate',
    'summary',
    'without_rigid_motion',
    'write_bag',
    'write_calibration',
    'write_diagnosis',
    'write_plan',
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used (PEP 562)."""
    for module, names in _HOMES.items():
        if name in names:
            value = getattr(import_module(f'otf_core.{module}'), name)
            globals()[name] = value
            return value
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    """Public names, and what is loaded already."""
    return sorted({*globals(), *__all__})

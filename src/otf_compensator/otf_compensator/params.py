# SPDX-License-Identifier: Apache-2.0
"""Parameters of the compensator node."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.config import Parameters, parameter


@dataclass(frozen=True)
class CompensatorConfig(Parameters):
    """Which tables; read at start and at every ``compensator/reload``."""

    auto_start: bool = parameter(
        True, 'configure and activate at start; false: wait for lifecycle transitions'
    )
    tables_file: str = parameter(
        '', 'error_tables.json of a calibration, such as calibrations/latest/error_tables.json; '
        'required',
    )  # fmt: skip

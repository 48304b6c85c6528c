# SPDX-License-Identifier: Apache-2.0
"""Error tables in use: positions in, corrections out; no ROS."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from otf_core.errors import ConfigError
from otf_core.model.tables import load_tables
from otf_core.prediction.predict import check_points
from otf_core.prediction.predictor import Predictor

Vector: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class CompensatedPosition:
    """What tables say of one position; fields as of otf_msgs/msg/Compensation."""

    wanted: Vector
    error: Vector
    uncertainty: Vector
    corrected: Vector
    inside: bool


class Tables:
    """Error tables that are asked again and again.

    Parameters
    ----------
    file : str
        error_tables.json.

    Attributes
    ----------
    machine : str
        Name of the machine.
    run_id : str
        Of the calibration; empty where the file has none.
    words : str
        What they are, in a sentence.

    Raises
    ------
    ConfigError
        If none is given, or it cannot be read.
    """

    def __init__(self, file: str) -> None:
        if not file:
            raise ConfigError(
                'parameter tables_file: missing; give the path of an error_tables.json'
            )
        content = load_tables(file)
        if turning := content.tables.machine.rotary_names:
            raise ConfigError(
                f'parameter tables_file: {file} is of a machine with rotary axes '
                f'({", ".join(turning)}); the compensator corrects linear axes alone'
            )
        self._predictor = Predictor.of(content)
        self.run_id = str(content.extra.get('run_id', ''))
        self.machine = self._predictor.tables.machine.name
        self.words = f'error tables of {self.machine} from {file}; u holds {self._predictor.holds}'

    def notes(self, wanted: Sequence[Vector]) -> list[str]:
        """State which positions lie outside the axis ranges.

        Raises
        ------
        ConfigError
            If one is that of no such machine: not finite, or in mm.
        """
        q = np.array(wanted, dtype=float).reshape(-1, 3)
        if not np.all(np.isfinite(q)):
            raise ConfigError('wanted: a position is not finite')
        return check_points(self._predictor.tables, q, 'wanted')

    def ask(self, wanted: Sequence[Vector]) -> Iterator[CompensatedPosition]:
        """Evaluate at positions, m."""
        q = np.array(wanted, dtype=float).reshape(-1, 3)
        prediction, corrected = self._predictor.at(q), self._predictor.corrected(q)
        columns = (
            q.tolist(),
            prediction.error.tolist(),
            prediction.u.tolist(),
            corrected.tolist(),
        )
        for (w, e, u, c), within in zip(
            zip(*columns, strict=True), prediction.inside.tolist(), strict=True
        ):
            yield CompensatedPosition(tuple(w), tuple(e), tuple(u), tuple(c), within)

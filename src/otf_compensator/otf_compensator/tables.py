# SPDX-License-Identifier: Apache-2.0
"""Error tables in use: positions in, corrections out; no ROS."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.prediction.calibration_document import load_tables
from otf_core.prediction.predict import (
    EDGE,
    PredictedErrors,
    Predictor,
    check_points,
    table_ranges,
)


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
        self._predictor = Predictor.of(content)
        self.run_id = content.run_id
        self.machine = self._predictor.tables.machine.name
        self.words = f'error tables of {self.machine} from {file}; u holds {self._predictor.holds}'

    def points(self, wanted: Sequence[Sequence[float]], turned: Sequence[float]) -> Array:
        """Points (n, m), m and rad: X, Y, Z, and the angles of the rotary axes, else zero.

        Raises
        ------
        ConfigError
            If there are not as many angles as rotary axes and points, or a position is not finite.
        """
        machine = self._predictor.tables.machine
        shape = len(wanted), len(machine.rotary_names)
        if len(turned) not in (0, shape[0] * shape[1]):
            raise ConfigError(
                f'turned: {len(turned)} angles; {machine.name} needs {shape[1]} for each of '
                f'{shape[0]} positions: {", ".join(machine.rotary_names) or "no rotary axis"}'
            )
        angles = np.reshape(turned, shape) if len(turned) else np.zeros(shape)
        points = np.hstack([np.reshape(wanted, (-1, 3)), angles])
        if not np.all(np.isfinite(points)):
            raise ConfigError('wanted: a position is not finite')
        return points

    def ask(self, points: Array) -> tuple[PredictedErrors, Array, list[str]]:
        """Errors at points, X, Y, Z to command (n, 3), and what to know of them.

        Raises
        ------
        ConfigError
            If a pose lies outside of the axes of the machine.
        """
        machine, corrected = self._predictor.tables.machine, points.copy()
        q, (low, high) = machine.axis_positions(points), table_ranges(self._predictor.tables)
        low, high = np.minimum(low, machine.lower), np.maximum(high, machine.upper)
        out = np.maximum(low - machine.wrapped(q), machine.wrapped(q) - high) > EDGE
        if out.any():
            pose, k = (int(i) for i in np.argwhere(out)[0])
            name, unit = machine.axis_names[k], machine.axes[machine.axis_names[k]].unit
            raise ConfigError(
                f'wanted: pose {pose + 1} of {len(q)}: {name} = {q[pose, k]:g} {unit} is outside '
                f'of its axis, {low[k]:g} to {high[k]:g} {unit}; poses are in m and rad'
            )
        notes = check_points(self._predictor.tables, points, 'wanted')
        columns = [machine.point_names.index(a) for a in machine.axis_names]
        corrected[:, columns] = self._predictor.corrected(q)
        return self._predictor.at(q), corrected[:, :3], notes

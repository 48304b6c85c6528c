# SPDX-License-Identifier: Apache-2.0
"""Direct measurements as the text files that users bring."""

import numpy as np

from otf_core.comparison.direct import TWO_WAYS


def write_direct_csv(path, measurement):
    """Write a direct measurement in SI units."""
    lines = []
    for axis, readings in measurement.axes.items():
        lines.append(f'# point {axis}: ' + ','.join(map(repr, readings.point.tolist())))
    if measurement.target_offset is not None:
        offset = measurement.target_offset.tolist()
        lines.append('# target_offset: ' + ','.join(map(repr, offset)))
    if measurement.u_length_scale:
        lines.append(f'# u_length_scale: {measurement.u_length_scale!r}')
    lines.append('axis,run,direction,position_m,EX_m,EY_m,EZ_m,EA_rad,EB_rad,EC_rad')
    for axis, readings in measurement.axes.items():
        runs, ways, positions, _ = readings.value.shape
        for run, way, k in np.ndindex(runs, ways, positions):
            k = k if way == 0 else positions - 1 - k
            numbers = [readings.position[k], *readings.value[run, way, k]]
            cells = ['' if np.isnan(v) else repr(float(v)) for v in numbers]
            lines.append(f'{axis},{run + 1},{TWO_WAYS[way]},' + ','.join(cells))
    path.write_text('\n'.join(lines) + '\n')

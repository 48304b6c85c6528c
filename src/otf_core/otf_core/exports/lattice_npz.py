# SPDX-License-Identifier: Apache-2.0
"""Neutral lattice as a numpy archive: x, y, z, error and u (nx, ny, nz, 3), and the covariance."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from otf_core.exports.format import POINT_WORDS, ExportedFiles, Format, Request
from otf_core.exports.lattice import lattice_covariance, sampled_lattice
from otf_core.prediction.predict import predict

COVARIANCE_POINTS_PER_AXIS = 8
COVARIANCE_POINTS = COVARIANCE_POINTS_PER_AXIS**3
"""Points whose covariance is held: that of so many takes 19 MB, and grows with their square."""


class LatticeNpz(Format):
    """Volumetric errors on a lattice with their uncertainties and the covariance of all."""

    name = 'lattice-npz'
    value_words = POINT_WORDS
    lacks = (
        'values between lattice points (interpolate trilinearly), other target offsets '
        f'than the measured one, the covariance of more than {COVARIANCE_POINTS} points; '
        f'differences between the directions of travel'
    )
    takes_points = True

    def sign_words(self, request: Request) -> str:
        """State what the values are."""
        return (
            'error is actual minus nominal, u its standard uncertainty, m; covariance, m^2, of '
            'error.ravel(): Z fastest of the points, then the components'
        )

    def export(self, request: Request) -> ExportedFiles:
        """Make the archive."""
        self.check(request)
        lattice, remarks = sampled_lattice(request.content.tables, request.points)
        q = lattice.points
        held: dict[str, Any] = {'error': lattice.error}
        held['u'] = predict(request.content, q).u.reshape(lattice.error.shape)
        if len(q) <= COVARIANCE_POINTS:
            held['covariance'] = lattice_covariance(request.content, q)
        else:
            remarks += (
                f'without covariance, since {len(q)} points are more than {COVARIANCE_POINTS}; '
                f'--points {COVARIANCE_POINTS_PER_AXIS} or fewer has it',
            )
        packed = io.BytesIO()
        x, y, z = lattice.axes
        # not compressed: the words stand readable at the beginning of the file
        about = np.array('\n'.join(request.header(self)).encode())
        np.savez(packed, about=about, x=x, y=y, z=z, **held)
        return ExportedFiles({request.name: packed.getvalue()}, lattice.at, remarks)


FORMAT = LatticeNpz()

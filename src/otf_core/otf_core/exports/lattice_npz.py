# SPDX-License-Identifier: Apache-2.0
"""Neutral lattice as a numpy archive: x, y, z, error (nx, ny, nz, 3) and its whole covariance."""

from __future__ import annotations

import io

import numpy as np

from otf_core.errors import ConfigError
from otf_core.exports.base import Exported, Format, Request
from otf_core.exports.lattice import Lattice, lattice_covariance, sampled_lattice

MOST_POINTS, INSTEAD = 512, 7
"""Points if the user names no number: 512 take 19 MB of covariance."""
MOST = 13
"""Points per axis: the covariance of 13 takes 350 MB."""


class LatticeNpz(Format):
    """Volumetric errors on a lattice with the covariance of all of them."""

    name = 'lattice-npz'
    lacks = (
        'the course between lattice points (take trilinear interpolation), other target offsets '
        'than the measured one; differences between the directions of travel'
    )

    def sign_words(self, request: Request) -> str:
        """Say what the values are."""
        return (
            'error is actual minus nominal, m; covariance, m^2, of error.ravel(): Z fastest of '
            'the points, then the components'
        )

    def export(self, request: Request) -> Exported:
        """Make the archive."""
        self.check(request)
        lattice = sampled_lattice(request.content.tables, request.points, MOST_POINTS, INSTEAD)
        covariance = lattice_covariance(request.content, lattice.points)
        packed = io.BytesIO()
        x, y, z = lattice.axes
        # not compressed: the words stand readable at the beginning of the file
        np.savez(
            packed,
            about=np.array('\n'.join(request.header(self)).encode()),
            x=x, y=y, z=z, error=lattice.error, covariance=covariance,
        )  # fmt: skip
        held = Lattice(lattice.axes, lattice.error)
        return Exported({request.name: packed.getvalue()}, held.at)

    def check(self, request: Request) -> None:
        """Refuse a covariance that fills the memory."""
        super().check(request)
        if request.points is not None and request.points > MOST:
            raise ConfigError(
                f'--points: {self.name} holds the covariance of all points; at most {MOST}'
            )


FORMAT = LatticeNpz()

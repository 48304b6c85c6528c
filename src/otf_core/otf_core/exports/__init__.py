# SPDX-License-Identifier: Apache-2.0
"""Error tables for controls and other programs: one line here for each format.

Light: the command line loads it for the names. A format says what sign its values have, what it
cannot hold, and which error a control that reads the file takes off.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from otf_core.exports.format import Format

HOMES = {
    'linuxcnc': 'linuxcnc',
    'sinumerik-enc': 'sinumerik',
    'sinumerik-cec': 'sinumerik',
    'isg': 'iso_names',
    'etalon': 'iso_names',
    'pivot': 'pivot',
    'lattice-csv': 'lattice',
}
"""Formats by name, and the modules they live in."""


def export_format(name: str) -> Format:
    """Return the format of a name in ``HOMES``."""
    formats = import_module(f'otf_core.exports.{HOMES[name]}').FORMATS
    found: Format = next(f for f in formats if f.name == name)
    return found


__all__ = ['HOMES', 'export_format']

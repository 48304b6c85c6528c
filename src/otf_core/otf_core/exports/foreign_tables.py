# SPDX-License-Identifier: Apache-2.0
"""Error tables of other systems, recognised by the content of their files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from otf_core.errors import ConfigError
from otf_core.exports import export_format
from otf_core.exports.iso_tables import SIGNS, holds_iso_tables, read_iso_tables
from otf_core.exports.lattice import holds_lattice, read_lattice_csv, tables_from_lattice
from otf_core.model.machine import Machine
from otf_core.model.tables import ErrorTables


@dataclass(frozen=True)
class ForeignTables:
    """Tables without uncertainties.

    Attributes
    ----------
    size_rms, left_rms : float
        m; of the errors on a lattice, and of what the tables do not follow; else 0.
    remarks : tuple of str
        What was taken for what.
    """

    tables: ErrorTables
    size_rms: float = 0.0
    left_rms: float = 0.0
    remarks: tuple[str, ...] = ()


def holds_foreign_tables(path: str | Path) -> bool:
    """Return whether a text is a lattice, in the Etalon exchange format or ISG CSV."""
    return holds_iso_tables(path) or holds_lattice(path)


def read_foreign_tables(
    path: str | Path, machine: Machine, sign: str | None = None
) -> ForeignTables:
    """Read a lattice of volumetric errors, the Etalon exchange format or ISG CSV.

    Parameters
    ----------
    sign : 'error' or 'correction', optional
        What the values are; errors, as actual minus nominal, if not given.

    Raises
    ------
    ConfigError
        Names what is wrong, and where.
    """
    if sign not in (None, *SIGNS):
        raise ConfigError(f'--sign: {sign!r}; possible: {", ".join(SIGNS)}')
    if holds_iso_tables(path):
        tables, remarks = read_iso_tables(path, machine, sign)
        return ForeignTables(tables, remarks=remarks)
    export_format('lattice-csv').check_machine(machine, 'import')
    fitted = tables_from_lattice(read_lattice_csv(path), machine)
    tables, remarks = fitted.tables, ()
    if sign == SIGNS[1]:
        tables, remarks = tables.scaled(-1.0), ('the lattice is read as corrections',)
    return ForeignTables(tables, fitted.size_rms, fitted.left_rms, remarks)

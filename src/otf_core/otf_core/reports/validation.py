# SPDX-License-Identifier: Apache-2.0
"""Files of a validation: table and figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.direct_measurement import DirectMeasurement
from otf_core.model.provenance import provenance
from otf_core.reports.plots.validation import draw_validation
from otf_core.validation.run import Validation
from otf_core.validation.table import Row, format_rows, rows_to_dict

SCHEMA = 'otf-validation/1'
FILE = 'validation.json'
WORDS = 'agreement is judged with expanded uncertainties, k = 2'


def write_validation(
    found: Validation, measurement: DirectMeasurement, folder: str | Path
) -> list[Path]:
    """Write the figures, and the table as ``write_table`` does.

    Parameters
    ----------
    found : Validation
    measurement : DirectMeasurement
        The direct one of the first cell.
    folder : str or Path

    Returns
    -------
    list of Path
    """
    folder = ensure_folder(folder)
    files = draw_validation(found, measurement, folder)
    return [*files, *write_table(found.seeds, found.rows, folder)]


def write_table(seeds: Sequence[int], rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write validation.txt and validation.json; their paths.

    Parameters
    ----------
    seeds : sequence of int
        Of the cells.
    rows : sequence of Row
    folder : Path
    """
    data = {
        'schema': SCHEMA,
        'cells': list(seeds),
        'rows': rows_to_dict(rows),
        'provenance': provenance('validate', coverage=WORDS),
    }
    write_text(folder / 'validation.txt', format_rows(rows) + '\n')
    write_text(folder / FILE, json.dumps(data, indent=1, allow_nan=False) + '\n')
    return [folder / 'validation.txt', folder / FILE]

# SPDX-License-Identifier: Apache-2.0
"""Files of a validation: table and figures."""

from __future__ import annotations

import json
from pathlib import Path

from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.direct_measurement import DirectMeasurement
from otf_core.model.provenance import provenance
from otf_core.reports.plots.validation import draw_validation
from otf_core.validation.run import Validation
from otf_core.validation.table import format_rows, rows_to_dict

SCHEMA = 'otf-validation/1'
WORDS = 'agreement is judged with expanded uncertainties, k = 2'


def write_validation(
    found: Validation, measurement: DirectMeasurement, folder: str | Path
) -> list[Path]:
    """Write the figures, validation.txt and, last, validation.json.

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
    data = {
        'schema': SCHEMA,
        'cells': list(found.seeds),
        'rows': rows_to_dict(found.rows),
        'provenance': provenance('validate', coverage=WORDS),
    }
    files += [folder / 'validation.txt', folder / 'validation.json']
    write_text(files[-2], format_rows(found.rows) + '\n')
    write_text(files[-1], json.dumps(data, indent=1, allow_nan=False) + '\n')
    return files

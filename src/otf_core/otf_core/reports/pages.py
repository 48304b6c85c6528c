# SPDX-License-Identifier: Apache-2.0
"""Pages and text of any document, by its schema: what verbs, ``otf report`` and nodes write."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from jinja2 import UndefinedError

from otf_core.documents import ResultDocument
from otf_core.errors import InputError
from otf_core.files.strict_yaml import read_json
from otf_core.files.writing import ensure_folder, write_text

PAGES = {
    'otf-error-tables/2': ('calibration_page', 'calibration_pages', 'calibration_summary'),
    'otf-comparison/2': ('comparison', 'comparison_pages', 'format_comparison'),
    'otf-fleet/1': ('fleet_report', 'fleet_pages', 'format_fleet'),
    'otf-gap/1': ('diagnosis', 'gap_pages', 'format_diagnosis'),
    'otf-history/1': ('history_report', 'history_pages', 'format_history'),
    'otf-plan/2': ('plan_files', 'plan_pages', 'plan_summary'),
    'otf-noise/1': ('noise_report', 'noise_pages', 'format_noise'),
}
"""By schema: module, and functions that return the pages of a document by file name, and its text
for a terminal."""


def render_pages(data: Mapping[str, Any]) -> dict[str, str]:
    """Return the pages of the plain data of a document by their names."""
    pages: dict[str, str] = _function(data, 1)(data)
    return pages


def summary_of(document: ResultDocument) -> str:
    """Return the text that a terminal shows of a document."""
    data = document.to_dict()
    return str(_function(data, 2)(data)).rstrip('\n')


def _function(data: Mapping[str, Any], which: int) -> Any:
    names = PAGES[data['schema']]
    return getattr(import_module(f'otf_core.reports.{names[0]}'), names[which])


def pages_of(file: str | Path) -> dict[str, str]:
    """Return the pages of a result file by their names.

    Raises
    ------
    InputError
        If it is no result file, or one without a page.
    """
    doc = read_json(file)
    schema = doc.get('schema') if isinstance(doc, Mapping) else None
    if schema not in PAGES:
        raise InputError(f'{file}: no result with a page; expected schema {", ".join(PAGES)}')
    try:
        return render_pages(doc)
    except (LookupError, TypeError, ValueError, AttributeError, UndefinedError) as error:
        raise InputError(
            f'{file}: incomplete, or of an older version ({error}); run its verb again'
        ) from None


def write_document(document: ResultDocument, folder: str | Path) -> list[Path]:
    """Write the pages of a document and, last, its file; the folder is made if missing.

    Raises
    ------
    ConfigError
        If the folder cannot be written.
    """
    folder, data = ensure_folder(folder), document.to_dict()
    texts = render_pages(data)
    texts[document.file] = json.dumps(data, indent=1, allow_nan=False) + '\n'
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]

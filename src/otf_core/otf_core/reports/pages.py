# SPDX-License-Identifier: Apache-2.0
"""Pages of any result file that has one, by its schema: what its verb writes beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from jinja2 import UndefinedError

from otf_core.errors import InputError
from otf_core.files.strict_yaml import read_json

PAGES = {
    'otf-error-tables/2': ('calibration_page', 'calibration_pages'),
    'otf-comparison/2': ('comparison', 'comparison_pages'),
    'otf-fleet/1': ('fleet_report', 'fleet_pages'),
    'otf-gap/1': ('diagnosis', 'gap_pages'),
    'otf-history/1': ('history_report', 'history_pages'),
    'otf-plan/2': ('plan_files', 'plan_pages'),
    'otf-noise/1': ('noise_report', 'noise_pages'),
}
"""Module and function that returns the pages of a document by file name, by schema."""


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
    module, name = PAGES[schema]
    pages: Callable[[Mapping[str, Any]], dict[str, str]]
    pages = getattr(import_module(f'otf_core.reports.{module}'), name)
    try:
        return pages(doc)
    except (LookupError, TypeError, ValueError, AttributeError, UndefinedError) as error:
        raise InputError(
            f'{file}: incomplete, or of an older version ({error}); run its verb again'
        ) from None

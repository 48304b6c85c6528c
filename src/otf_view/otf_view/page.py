# SPDX-License-Identifier: Apache-2.0
"""The page as one text: style and script are put into it, so it needs nothing from anywhere."""

from __future__ import annotations

from functools import cache
from pathlib import Path

FOLDER = Path(__file__).with_name('web')


@cache
def page() -> str:
    """Return the page."""
    text = (FOLDER / 'page.html').read_text(encoding='utf-8')
    style = (FOLDER / 'page.css').read_text(encoding='utf-8')
    script = '\n'.join(
        (FOLDER / name).read_text(encoding='utf-8') for name in ('picture.js', 'page.js')
    )
    return text.replace('/* style */', style).replace('/* script */', script)

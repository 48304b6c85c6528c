# SPDX-License-Identifier: Apache-2.0
"""Texts for people: long ones shortened where a reader would, units with their signs."""

from __future__ import annotations

import re
from collections.abc import Iterable

LONGEST_QUOTATION = 60
"""Characters of a name or key from a file that a message repeats."""
_NUMBER_PARTS = re.compile(r'[\d.]')
_NUMBER_AT_END = re.compile(r'[+-]?\d[\d.]*(?:[eE][+-]?\d*)?$')
_MICRO_UNIT = re.compile(r'(?<![A-Za-z0-9_])u(m|rad)(?![A-Za-z0-9_])')


def shortened(text: str, length: int = LONGEST_QUOTATION) -> str:
    """Cut a long text after a word and mark the cut by an ellipsis.

    A word that fills half of the length is cut itself, but never inside a number, whose rest
    would be another one.
    """
    if len(text) <= length:
        return text
    cut = text.rfind(' ', 0, length)
    if cut <= length // 2:
        inside = _NUMBER_PARTS.match(text, length) and _NUMBER_AT_END.search(text[:length])
        cut = inside.start() if inside and inside.start() else length
    return f'{text[:cut].rstrip(" ,;:")} ...'


def without_middle(text: str, length: int) -> str:
    """Beginning and end of a long text, both at whole words, with an ellipsis between them."""
    if len(text) <= length:
        return text
    half = length // 2
    end = text[-half:]
    space = end.find(' ')
    return f'{shortened(text, half)} {end[space + 1 :] if 0 <= space < half // 2 else end}'


def with_micro_sign(text: str) -> str:
    """Replace the units um and urad by µm and µrad, but not in identifiers such as mean_um."""
    return _MICRO_UNIT.sub('\N{MICRO SIGN}\\1', text)


def join_names(names: Iterable[str]) -> str:
    """Names with commas and a last 'and'."""
    texts = list(names)
    return ' and '.join([', '.join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)

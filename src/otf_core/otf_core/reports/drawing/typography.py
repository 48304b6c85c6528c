# SPDX-License-Identifier: Apache-2.0
"""Plain text as metrologists write it: µm and µrad, ±, minus signs."""

from __future__ import annotations

import html
import re


def typeset(value: object) -> str:
    """Text with proper signs, not escaped."""
    plain = re.sub(r'(?<![A-Za-z0-9_])u(m|rad)(?![A-Za-z0-9_])', r'µ\1', str(value))
    plain = re.sub(r'(?<![^ (])\+/-(?= )', '±', plain)
    plain = re.sub(r'(?<![\w.])-(?=\d|[XYZ]\b)', '\N{MINUS SIGN}', plain)
    plain = re.sub(r'(?<=\d) deg\b', '\N{DEGREE SIGN}', plain)
    return re.sub(r'(?<=\d) (?=%)', '\u00a0', plain)


def text(value: object) -> str:
    """The same, escaped for HTML."""
    return html.escape(typeset(value), quote=True)

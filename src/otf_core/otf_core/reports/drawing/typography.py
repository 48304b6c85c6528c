# SPDX-License-Identifier: Apache-2.0
"""Plain text as metrologists write it: µm and µrad, ±, minus signs."""

from __future__ import annotations

import html
import re

SPACE = '\u00a0'
"""Does not break a line."""
UNITS = '%|[µmk]?m|µrad|mrad|rad|µs|ms|s|min|h|d|°C|K|Hz|Pa|m/s|m/s²'


def typeset(value: object) -> str:
    """Text with proper signs, not escaped; a value stays on the line of its sign and unit."""
    plain = re.sub(r'(?<![A-Za-z0-9_])u(m|rad)(?![A-Za-z0-9_])', r'µ\1', str(value))
    plain = re.sub(r'(?<![^ (])\+/-(?= )', '±', plain)
    plain = re.sub(r'(?<![\w.])-(?=0(?:\.0+)?(?![\w.]))', '', plain)
    plain = re.sub(r'(?<![\w.])-(?=\d|[XYZ]\b)', '\N{MINUS SIGN}', plain)
    plain = re.sub(r'(?<=\d) deg\b', '\N{DEGREE SIGN}', plain)
    plain = re.sub(r'(?<=\S) (?=(?:±|→) )|(?<=[±→]) (?=\S)', SPACE, plain)
    return re.sub(rf'(?<=\d) (?=(?:{UNITS})(?![A-Za-z]))', SPACE, plain)


def text(value: object) -> str:
    """The same, escaped for HTML."""
    return html.escape(typeset(value), quote=True)

# SPDX-License-Identifier: Apache-2.0
"""Units that headings state, and the factors that take them to m, rad and s."""

from __future__ import annotations

import math
import re

LENGTHS = {
    'm': 1.0, 'dm': 1e-1, 'cm': 1e-2, 'mm': 1e-3, 'um': 1e-6, 'µm': 1e-6, 'μm': 1e-6,
    'in': 0.0254, 'inch': 0.0254, 'inches': 0.0254, 'zoll': 0.0254, 'pouce': 0.0254,
    'pouces': 0.0254, 'metre': 1.0, 'metres': 1.0, 'meter': 1.0, 'meters': 1.0,
    'millimetre': 1e-3, 'millimetres': 1e-3, 'millimeter': 1e-3, 'millimeters': 1e-3,
    'micron': 1e-6, 'microns': 1e-6, '毫米': 1e-3, '米': 1.0, '微米': 1e-6, '英寸': 0.0254,
}  # fmt: skip
"""To m."""
ANGLES = {
    'rad': 1.0, 'mrad': 1e-3, 'urad': 1e-6, 'µrad': 1e-6, 'μrad': 1e-6,
    'deg': math.pi / 180, 'degree': math.pi / 180, 'degrees': math.pi / 180,
    '°': math.pi / 180, '度': math.pi / 180,
    'gon': math.pi / 200, 'arcsec': math.pi / 648000, '"': math.pi / 648000,
}  # fmt: skip
"""To rad."""
AMBIGUOUS = ('grad', 'grads')
"""Degrees in German and Italian, gon in English and on instruments: has to be stated."""
TIMES = {
    's': 0, 'sec': 0, 'secs': 0, 'second': 0, 'seconds': 0, 'sekunden': 0, '秒': 0,
    'ms': -3, 'msec': -3, 'milliseconds': -3, '毫秒': -3,
    'us': -6, 'usec': -6, 'µs': -6, 'μs': -6, 'ns': -9, 'nsec': -9, 'nsecs': -9, 'nanosec': -9,
}  # fmt: skip
"""Powers of ten, to s."""
LONG_TIMES = {
    'min': 60, 'minute': 60, 'minutes': 60, 'minuten': 60, 'h': 3600, 'hour': 3600, 'hours': 3600,
    'std': 3600, 'day': 86400, 'days': 86400, 'tage': 86400,
}  # fmt: skip
"""To s."""
OTHERS = (
    'mil', 'mils', 'ft', 'foot', 'feet', 'nm', 'km', *AMBIGUOUS,
)  # fmt: skip
"""Units that a heading may state and nothing is read in: refused, never taken for another."""
BRACKETED = re.compile(
    r'^(?P<name>.*?)\s*[\[({<（【]\s*(?P<unit>[^\])}>）】]*)\s*[\])}>）】]\s*$', re.DOTALL
)
SUFFIX = re.compile(
    r'^(?P<name>.+?)[_ /]'
    r'(?P<unit>m|dm|cm|mm|um|µm|μm|inch|in|mil|ft|nm|km|s|sec|ms|us|µs|ns|min|deg|grad|gon|'
    r'rad|mrad|urad|dmy|mdy|ymd)$'
)

LONGEST = 200
"""Letters of a heading."""
LINK = re.compile(r'(?:\s+in|[\s/,:-]+)$')
"""Between a name and its unit: 'X in mm', 'X / mm'."""


def is_unit(text: str) -> bool:
    """Tell whether a text is the name of a unit."""
    text = text.lower()
    return any(text in known for known in (LENGTHS, ANGLES, TIMES, LONG_TIMES, OTHERS))


def parted(heading: str) -> tuple[str, str | None]:
    """Name, in lower case, and unit of a heading; what stands in brackets and is no unit stays."""
    if len(heading) > LONGEST:
        return heading[:LONGEST].lower(), None
    text = ' '.join(heading.strip().lstrip('%').split())
    match = BRACKETED.match(text)
    if match is not None and not match['name'].strip():
        return match['unit'].strip().lower(), None  # '[Timestamp]'
    if match is not None and is_unit(match['unit'].strip()):
        return match['name'].strip().lower(), match['unit'].strip().lower()
    match = SUFFIX.match(text.lower())
    if match is not None:
        return LINK.sub('', match['name']).strip(), match['unit']
    return text.lower(), None


def known_lengths() -> str:
    """Return units of length, as messages name them."""
    return 'm, dm, cm, mm, µm (or um), inch'


def unit_hint(stated: float, expected: float) -> str:
    """Unit that lengths may be in, whose size, read in m, is another than expected.

    Parameters
    ----------
    stated, expected : float
        m; the largest coordinates.

    Returns
    -------
    str
        'mm', 'um', 'inch', 'cm' or empty.
    """
    if expected <= 0.0 or stated <= 0.0:
        return ''
    fits = [u for u in HINTED if 0.5 < stated * LENGTHS[u] / expected < 1.05]
    return fits[0] if fits else ''


HINTED = ('mm', 'inch', 'um', 'cm')
"""In the order of how usual they are."""


def unit_words(unit: str) -> str:
    """Unit as people read it."""
    return 'µm' if unit == 'um' else unit

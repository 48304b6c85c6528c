# SPDX-License-Identifier: Apache-2.0
"""Documents to pages: Jinja2 templates, and numbers and text as metrologists write them.

A page is a function of the dictionary of a result file. It needs nothing else: style and script
are put into it, charts are SVG elements.
"""

from __future__ import annotations

import html
import math
import os
import re
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import BytecodeCache, Environment, FileSystemLoader, StrictUndefined
from jinja2.bccache import Bucket
from markupsafe import Markup

from otf_core.files.message_text import join_names, shortened, with_micro_sign
from otf_core.files.writing import tidy
from otf_core.model.expanded import (
    figure,
    micro_figure,
    micro_significant,
    micro_unit,
    micro_with_expanded,
    significant,
    with_expanded,
)
from otf_core.prediction.absorbed import offset_words

TEMPLATES = Path(__file__).with_name('templates')
SPACE = '\u00a0'
"""Does not break a line."""
UNITS = '%|[µmk]?m|µrad|mrad|rad|µs|ms|s|min|h|d|°C|K|Hz|Pa|m/s|m/s²'


def typeset(value: object) -> str:
    """Text with proper signs, not escaped; a value stays on the line of its sign and unit."""
    plain = with_micro_sign(str(value))
    plain = re.sub(r'(?<![^ (])\+/-(?= )', '±', plain)
    plain = re.sub(r'(?<![\w.])-(?=0(?:\.0+)?(?![\w.]))', '', plain)
    plain = re.sub(r'(?<![\w.])-(?=\d|[XYZ]\b)', '\N{MINUS SIGN}', plain)
    plain = re.sub(r'(?<=\d) deg\b', '\N{DEGREE SIGN}', plain)
    plain = re.sub(r'(?<=\S) (?=(?:±|→) )|(?<=[±→]) (?=\S)', SPACE, plain)
    return re.sub(rf'(?<=\d) (?=(?:{UNITS})(?![A-Za-z]))', SPACE, plain)


def escaped(value: object) -> str:
    """The same, escaped for HTML."""
    return html.escape(typeset(value), quote=True)


@dataclass(frozen=True)
class State:
    """A state in words, in the colour of its mood: 'good', 'bad', 'open' or none."""

    words: str
    mood: str = ''


def micro(value: float, digits: int = 2) -> str:
    """A value in millionths: um for m, urad for rad."""
    return f'{1e6 * value + 0.0:.{digits}f}'


def millimetres(value: float) -> str:
    """A position, m, in mm to 0.1 mm, without zeros at its end."""
    return f'{tidy(round(1e3 * value, 1)):g}'


def place(point: Iterable[float]) -> str:
    """A point, m, in words, in mm."""
    return ', '.join(f'{a} {millimetres(v)}' for a, v in zip('XYZ', point, strict=True)) + ' mm'


def sentence(words: str) -> str:
    """A clause as a sentence: with a capital and a full stop."""
    return f'{words[:1].upper()}{words[1:]}' + ('' if words.endswith(('.', '?', '!')) else '.')


def dof_words(dof: int | None) -> str:
    """Effective degrees of freedom of a document; None: infinite."""
    return 'infinite' if dof is None else str(dof)


def columns_to_text(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """Lines of a table for a terminal; numbers are set to the right."""
    texts = [[str(getattr(cell, 'words', cell)) for cell in row] for row in rows]
    wide = [max(map(len, column)) for column in zip(head, *texts, strict=True)]
    right = [
        all(re.fullmatch(r'[-+\d.e]*( mm| deg)?', r[k]) for r in texts) for k in range(len(head))
    ]
    return [
        '  '.join(
            cell.rjust(w) if own else cell.ljust(w)
            for cell, w, own in zip(row, wide, right, strict=True)
        ).rstrip()
        for row in (list(head), *texts)
    ]


def running_head(words: str) -> Markup:
    """Rules that print words at the head, and the number of the page at the foot, of each page."""
    quoted = ''.join(c if c.isalnum() or c in ' .,:;-+/()' else f'\\{ord(c):x} ' for c in words)
    box = 'font: 8pt system-ui, "DejaVu Sans", sans-serif; color: #59636e;'
    return Markup(
        '@page { size: A4; margin: 16mm 14mm 14mm; '
        f'@top-left {{ content: "{quoted}"; {box} }} '
        f'@bottom-right {{ content: counter(page) " / " counter(pages); {box} }} }}\n'
    )


def _anchors(page: str) -> list[tuple[str, Markup]]:
    """Anchor and title of every section."""
    found = re.findall(r'<section id="([^"]+)"><h2>(.*?)</h2>', str(page))
    return [(anchor, Markup(title)) for anchor, title in found]


class CompiledTemplates(BytecodeCache):
    """Compiled templates beside their sources, as Python keeps modules: 0.2 s of every page."""

    def _file(self, bucket: Bucket) -> Path:
        return TEMPLATES / '__pycache__' / f'{bucket.key}.{sys.implementation.cache_tag}'

    def load_bytecode(self, bucket: Bucket) -> None:
        """Take what was compiled from this source, if anything."""
        with suppress(OSError), self._file(bucket).open('rb') as file:
            bucket.load_bytecode(file)

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep what was compiled, where that can be written."""
        if sys.dont_write_bytecode:
            return
        with suppress(OSError):
            file = self._file(bucket)
            file.parent.mkdir(exist_ok=True)
            own = file.with_suffix(f'.{os.getpid()}')
            own.write_bytes(bucket.bytecode_to_string())
            own.replace(file)


@cache
def environment(page: bool = True) -> Environment:
    """Templates of pages, or of text for a terminal."""
    made = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=page,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=False,
        finalize=_typeset_but_markup if page else None,
        extensions=['jinja2.ext.do'],
        bytecode_cache=CompiledTemplates(),
    )
    plain = (
        *(figure, micro, micro_figure, micro_significant, micro_unit, micro_with_expanded),
        *(place, running_head, sentence, shortened, tidy, significant, with_expanded),
    )
    made.filters |= {one.__name__: one for one in plain}
    made.filters |= {
        'anchors': _anchors,
        'capital': lambda words: words[:1].upper() + words[1:],
        'dof': dof_words,
        'names': join_names,
        'offset': lambda offset: offset_words(np.array(offset)),
    }
    made.globals |= {'State': State, 'nan': math.nan}
    if page:
        made.globals |= {
            'style': Markup((TEMPLATES / 'page.css').read_text(encoding='utf-8')),
            'script': Markup((TEMPLATES / 'scene.js').read_text(encoding='utf-8')),
        }
    return made


def _typeset_but_markup(value: Any) -> Any:
    return value if isinstance(value, Markup) else typeset(value)


def render(template: str, **content: Any) -> str:
    """Return the page or the text of a template; ``.html.j2`` are pages.

    Parameters
    ----------
    content
        What the template names; charts as ``Markup``.
    """
    made = environment(template.endswith('.html.j2'))
    return made.get_template(template).render(**content).rstrip('\n') + '\n'

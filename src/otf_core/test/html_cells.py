# SPDX-License-Identifier: Apache-2.0
"""Reads pages as a browser does: tags in order, references, words, tables."""

import re
from html.parser import HTMLParser

VOID = {'meta', 'br', 'hr', 'img', 'link', 'input'}
FORBIDDEN = ('link', 'iframe', 'object', 'img', 'embed')


class Page(HTMLParser):
    """What a page holds.

    ``faults``: tags closed out of order, and tags that load something; ``tables``: title and rows
    of every table, first its heads.
    """

    def __init__(self, page):
        super().__init__()
        self.open, self.faults, self.references, self.words = [], [], [], []
        self.tables, self.scripts, self._cell, self._title = [], 0, None, ''
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.references += [v for k, v in attrs if k in ('href', 'src', 'xlink:href', 'data')]
        if tag not in VOID:
            self.open.append(tag)
        if tag in FORBIDDEN:
            self.faults.append(tag)
        self.scripts += tag == 'script'
        if tag == 'table':
            self.tables.append((self._title, []))
        elif tag == 'tr':
            self.tables[-1][1].append([])
        elif tag in ('td', 'th', 'caption', 'summary', 'h2'):
            self._cell = []

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(f'/{tag}')
        if tag in ('td', 'th'):
            self.tables[-1][1][-1].append(' '.join(self._cell).strip())
        elif tag == 'caption':
            self.tables[-1] = (' '.join(self._cell), self.tables[-1][1])
        elif tag in ('summary', 'h2'):
            self._title = ' '.join(self._cell)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ('style', 'script'):
            self.words.append(data)
            if self._cell is not None:
                self._cell.append(data)

    @property
    def text(self):
        return re.sub(r'\s+', ' ', ' '.join(self.words))

    def rows(self, title):
        """Rows of the table of a title, without its heads."""
        found = next(rows for name, rows in self.tables if name.startswith(title))
        return found[1:] if found[0] and found[0][0] != found[-1][0] else found


def number(text):
    """A number as it stands in a page."""
    return float(text.replace('\N{MINUS SIGN}', '-'))


def unloading(page):
    """Why a page would need anything else; empty if it does not."""
    found = [r for r in Page(page).references if not r.startswith('#')]
    found += re.findall(r'https?:[^"\s]*|@import[^;]*|url\((?!#)[^)]*|\bsrc=', page)
    return found

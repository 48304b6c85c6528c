# SPDX-License-Identifier: Apache-2.0
"""What mkdocs does not do itself: the first page, equations, links into the sources."""

import html
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.structure.files import File

OUTSIDE = re.compile(r'\[([^\]]+)\]\((\.\./[^)]*)\)')
"""Links to files beside docs/; in the repository they lead somewhere, on the site they do not."""
EQUATION = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL)


def on_files(files, config):
    """The README as first page, its links as seen from docs/."""
    text = (Path(config['docs_dir']).parent / 'README.md').read_text(encoding='utf-8')
    text = re.sub(r'\]\((?!https?:|docs/)', '](../', text).replace('](docs/', '](')
    files.append(File.generated(config, 'index.md', content=text))
    return files


def on_page_markdown(markdown, **_):
    return OUTSIDE.sub(r'\1', markdown)


def on_page_content(page_html, **_):
    """TeX of equations as MathML."""

    def typeset(match):
        return f'<p>{convert(html.unescape(match[1]).strip(), display="block")}</p>'

    return EQUATION.sub(typeset, page_html)

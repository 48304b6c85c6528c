# SPDX-License-Identifier: Apache-2.0
"""What mkdocs does not do itself: the first page, equations, links into the sources."""

import ast
import html
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = re.compile(r'\[([^\]]+)\]\((\.\./[^)]*)\)')
"""Links to files beside docs/; in the repository they lead somewhere, on the site they do not."""
EQUATION = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL)


def on_files(files, config):
    """The README as first page, its links as seen from docs/."""
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    text = re.sub(r'\]\((?!https?:|docs/)', '](../', text).replace('](docs/', '](')
    files.append(File.generated(config, 'index.md', content=text))
    return files


def on_page_markdown(markdown, page, **_):
    """Public names of the package on the page that describes them."""
    if page.file.src_uri == 'api.md':
        source = (ROOT / 'src/otf_core/otf_core/__init__.py').read_text(encoding='utf-8')
        homes = ast.literal_eval(re.search(r'^_HOMES = (\{.*?^\})', source, re.M | re.S)[1])
        names = [f'::: otf_core.{home}.{name}' for home, own in homes.items() for name in own]
        markdown = '\n\n'.join([markdown, *names])
    return OUTSIDE.sub(r'\1', markdown)


def on_page_content(page_html, **_):
    """TeX of equations as MathML."""

    def typeset(match):
        return f'<p>{convert(html.unescape(match[1]).strip(), display="block")}</p>'

    return EQUATION.sub(typeset, page_html)

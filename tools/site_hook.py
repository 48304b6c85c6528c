# SPDX-License-Identifier: Apache-2.0
"""What mkdocs does not do itself: equations, links into the sources, pages without a place."""

import html
import re
from pathlib import Path

from latex2mathml.converter import convert

OUTSIDE = re.compile(r'\[([^\]]+)\]\((\.\./[^)]*)\)')
"""Links to files beside docs/; in the repository they lead somewhere, on the site they do not."""
EQUATION = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL)


def listed(nav):
    """Pages that a navigation names."""
    for entry in nav:
        for target in entry.values() if isinstance(entry, dict) else [entry]:
            yield from listed(target) if isinstance(target, list) else [target]


def on_config(config):
    docs = Path(config['docs_dir'])
    decisions = sorted(str(p.relative_to(docs)) for p in (docs / 'decisions').glob('*.md'))
    known = {*listed(config['nav']), *decisions}
    others = sorted(p.name for p in docs.glob('*.md') if p.name not in known)
    for entry in config['nav']:
        if 'Decisions' in entry:
            entry['Decisions'] = decisions
        if 'How to' in entry:
            entry['How to'] += others
    return config


def on_page_markdown(markdown, page, **_):
    depth = page.file.src_uri.count('/')

    def shown(match):
        return match[1] if match[2].startswith('../' * (depth + 1)) else match[0]

    return OUTSIDE.sub(shown, markdown)


def on_page_content(page_html, **_):
    """TeX of equations as MathML."""

    def typeset(match):
        return f'<p>{convert(html.unescape(match[1]).strip(), display="block")}</p>'

    return EQUATION.sub(typeset, page_html)

# SPDX-License-Identifier: Apache-2.0
"""Figure of the packages of otf_core: layers and arrows from the imports alone.

Every package stands one layer above the highest package that it imports from. An arrow is omitted
where others lead to the same package.

Usage: python3 tools/house.py docs/images/house.svg
"""

from __future__ import annotations

import argparse
import ast
from pathlib import Path

CORE = Path(__file__).resolve().parents[1] / 'src/otf_core/otf_core'
WIDTH, STEP, BOX, HEIGHT = 900, 62, 118, 30


def imports() -> dict[str, set[str]]:
    """Packages, and the packages that each imports from."""
    packages = {p.name for p in CORE.iterdir() if (p / '__init__.py').exists()}
    found: dict[str, set[str]] = {package: set() for package in packages}
    for package in packages:
        for file in (CORE / package).rglob('*.py'):
            for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
                if isinstance(node, ast.ImportFrom) and node.module:
                    parts = node.module.split('.')
                    if parts[0] == 'otf_core' and len(parts) > 1 and parts[1] in packages:
                        found[package].add(parts[1])
        found[package].discard(package)
    return found


def layers(below: dict[str, set[str]]) -> dict[str, int]:
    """Layer of every package, the lowest is 0."""
    level: dict[str, int] = {}

    def of(package: str) -> int:
        if package not in level:
            level[package] = 1 + max((of(other) for other in below[package]), default=-1)
        return level[package]

    for package in sorted(below):
        of(package)
    return level


def reduced(below: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Arrows that are not implied by others."""

    def reach(package: str) -> set[str]:
        return below[package].union(*(reach(other) for other in below[package]))

    return sorted(
        (package, other)
        for package, others in below.items()
        for other in others
        if not any(other in reach(between) for between in others - {other})
    )


def picture() -> str:
    """Return the figure as SVG."""
    below = imports()
    level = layers(below)
    top = max(level.values())
    place: dict[str, tuple[float, float]] = {}
    for layer in range(top + 1):
        packages = sorted(package for package, at in level.items() if at == layer)
        for k, package in enumerate(packages):
            x = WIDTH * (k + 1) / (len(packages) + 1)
            place[package] = x + 40 * ((layer % 3) - 1), 30 + STEP * (top - layer)
    height = 60 + STEP * top
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        f'font-family="sans-serif" font-size="13">',
        '<title>Packages of otf_core: imports lead down</title>',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z" fill="#667"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
    ]
    for package, other in reduced(below):
        (x, y), (to_x, to_y) = place[package], place[other]
        parts.append(
            f'<path d="M{x:.0f} {y + HEIGHT / 2:.0f}L{to_x:.0f} {to_y - HEIGHT / 2 - 1:.0f}" '
            f'stroke="#99a" fill="none" marker-end="url(#tip)"/>'
        )
    for package, (x, y) in sorted(place.items()):
        parts.append(
            f'<rect x="{x - BOX / 2:.0f}" y="{y - HEIGHT / 2:.0f}" width="{BOX}" '
            f'height="{HEIGHT}" rx="4" fill="#eef3f8" stroke="#357"/>'
            f'<text x="{x:.0f}" y="{y + 5:.0f}" text-anchor="middle" fill="#123">{package}</text>'
        )
    return '\n'.join([*parts, '</svg>', ''])


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description='Draw which packages of otf_core import which.')
    parser.add_argument('svg', type=Path, help='file to write')
    parser.parse_args().svg.write_text(picture(), encoding='utf-8')

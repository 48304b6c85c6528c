# SPDX-License-Identifier: Apache-2.0
"""Picture of the packages of otf_core: layers and arrows from the imports alone.

Every room stands one floor above the highest room that it imports from. An arrow is left out
where others lead the same way.

Usage: python3 tools/house.py docs/images/house.svg
"""

from __future__ import annotations

import argparse
import ast
from pathlib import Path

CORE = Path(__file__).resolve().parents[1] / 'src/otf_core/otf_core'
WIDTH, STEP, BOX, HEIGHT = 900, 62, 118, 30


def imports() -> dict[str, set[str]]:
    """Rooms, and the rooms that each imports from."""
    rooms = {p.name for p in CORE.iterdir() if (p / '__init__.py').exists()}
    found: dict[str, set[str]] = {room: set() for room in rooms}
    for room in rooms:
        for file in (CORE / room).rglob('*.py'):
            for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
                if isinstance(node, ast.ImportFrom) and node.module:
                    parts = node.module.split('.')
                    if parts[0] == 'otf_core' and len(parts) > 1 and parts[1] in rooms:
                        found[room].add(parts[1])
        found[room].discard(room)
    return found


def floors(below: dict[str, set[str]]) -> dict[str, int]:
    """Floor of every room, the lowest is 0."""
    level: dict[str, int] = {}

    def of(room: str) -> int:
        if room not in level:
            level[room] = 1 + max((of(other) for other in below[room]), default=-1)
        return level[room]

    for room in sorted(below):
        of(room)
    return level


def reduced(below: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Arrows that are not implied by others."""

    def reach(room: str) -> set[str]:
        return below[room].union(*(reach(other) for other in below[room]))

    return sorted(
        (room, other)
        for room, others in below.items()
        for other in others
        if not any(other in reach(between) for between in others - {other})
    )


def picture() -> str:
    """Return the house as SVG."""
    below = imports()
    level = floors(below)
    top = max(level.values())
    place: dict[str, tuple[float, float]] = {}
    for floor in range(top + 1):
        rooms = sorted(room for room, at in level.items() if at == floor)
        for k, room in enumerate(rooms):
            x = WIDTH * (k + 1) / (len(rooms) + 1)
            place[room] = x + 40 * ((floor % 3) - 1), 30 + STEP * (top - floor)
    height = 60 + STEP * top
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        f'font-family="sans-serif" font-size="13">',
        '<title>Rooms of otf_core: imports lead down</title>',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z" fill="#667"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
    ]
    for room, other in reduced(below):
        (x, y), (to_x, to_y) = place[room], place[other]
        parts.append(
            f'<path d="M{x:.0f} {y + HEIGHT / 2:.0f}L{to_x:.0f} {to_y - HEIGHT / 2 - 1:.0f}" '
            f'stroke="#99a" fill="none" marker-end="url(#tip)"/>'
        )
    for room, (x, y) in sorted(place.items()):
        parts.append(
            f'<rect x="{x - BOX / 2:.0f}" y="{y - HEIGHT / 2:.0f}" width="{BOX}" '
            f'height="{HEIGHT}" rx="4" fill="#eef3f8" stroke="#357"/>'
            f'<text x="{x:.0f}" y="{y + 5:.0f}" text-anchor="middle" fill="#123">{room}</text>'
        )
    return '\n'.join([*parts, '</svg>', ''])


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description='Draw which packages of otf_core import which.')
    parser.add_argument('svg', type=Path, help='file to write')
    parser.parse_args().svg.write_text(picture(), encoding='utf-8')

# SPDX-License-Identifier: Apache-2.0
"""How a recording travels through the rooms of otf_core: measured, not read.

A bag is calibrated and diagnosed while every function notes when it is first called. The rooms
of these functions, in that order and with repetitions next to each other taken out, are the trip;
a move is a change of room, a climb one to a higher floor of ``tools/house.py``. The rooms that all
others speak in, ``model`` and ``files``, and what lies around it (``cli``, progress) do not count.

Usage: python3 tools/trips.py bags/y-carries-the-table
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from functools import partial
from itertools import groupby, pairwise
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from house import CORE, floors, imports

EVERYWHERE = ('model', 'files', 'live', 'cli')


def trip(walked: Callable[[], Any]) -> list[str]:
    """Rooms in the order in which functions in them are first called."""
    seen: dict[CodeType, str] = {}

    def note(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == 'call' and code not in seen:
            file = Path(code.co_filename)
            own = file.is_relative_to(CORE) and code.co_name not in ('<module>', '<lambda>')
            seen[code] = file.relative_to(CORE).parts[0] if own else ''

    sys.setprofile(note)
    try:
        walked()
    finally:
        sys.setprofile(None)
    level = floors(imports())
    rooms = (room for room in seen.values() if room in level and room not in EVERYWHERE)
    return [room for room, _ in groupby(rooms)]


def main() -> None:
    """Print both trips."""
    sys.path.insert(0, str(CORE.parent))
    from otf_core import cli

    folder, level = Path(sys.argv[1]), floors(imports())
    for verb in ('calibrate', 'diagnose'):
        with tempfile.TemporaryDirectory() as out:
            words = [verb, folder / 'bag', '--machine', folder / 'machine.yaml', '--out', out]
            rooms = trip(partial(cli.main, [*map(str, words), '--overwrite']))
        climbs = sum(level[b] > level[a] for a, b in pairwise(rooms))
        print(f'{verb}: {len(set(rooms))} rooms, {len(rooms) - 1} moves, {climbs} climbs')
        print(' '.join(rooms))


if __name__ == '__main__':
    main()

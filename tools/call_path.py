# SPDX-License-Identifier: Apache-2.0
"""Call path of a recording through the packages of otf_core, measured while it runs.

A bag is calibrated and diagnosed while every function notes when it is first called. The packages
of these functions, in that order and without repetitions next to each other, are the call path. A
change of package is upward if it leads to a higher layer of ``tools/house.py``. Packages that all
others use (``model``, ``files``) and those around the calculation (``cli``, ``live``) do not
count.

Usage: python3 tools/call_path.py bags/y-carries-the-table
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

from house import CORE, imports, layers

EVERYWHERE = ('model', 'files', 'live', 'cli')


def call_path(call: Callable[[], Any]) -> list[str]:
    """Packages in the order in which functions in them are first called."""
    seen: dict[CodeType, str] = {}

    def note(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == 'call' and code not in seen:
            file = Path(code.co_filename)
            own = file.is_relative_to(CORE) and code.co_name not in ('<module>', '<lambda>')
            seen[code] = file.relative_to(CORE).parts[0] if own else ''

    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
    level = layers(imports())
    packages = (name for name in seen.values() if name in level and name not in EVERYWHERE)
    return [name for name, _ in groupby(packages)]


def main() -> None:
    """Print the call paths of a calibration and of a diagnosis."""
    sys.path.insert(0, str(CORE.parent))
    from otf_core import cli

    folder, level = Path(sys.argv[1]), layers(imports())
    for verb in ('calibrate', 'diagnose'):
        with tempfile.TemporaryDirectory() as out:
            words = [verb, folder / 'bag', '--machine', folder / 'machine.yaml', '--out', out]
            packages = call_path(partial(cli.main, [*map(str, words), '--overwrite']))
        upward = sum(level[b] > level[a] for a, b in pairwise(packages))
        changes = f'{len(packages) - 1} changes, {upward} of them upward'
        print(f'{verb}: {len(set(packages))} packages, {changes}')
        print(' '.join(packages))


if __name__ == '__main__':
    main()

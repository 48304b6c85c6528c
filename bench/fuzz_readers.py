# SPDX-License-Identifier: Apache-2.0
"""Mutated files through all readers: crashes, messages without bounds, memory, time.

python3 bench/fuzz_readers.py [COUNT] [SEED] [KIND ...]
"""

from __future__ import annotations

import logging
import resource
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'src' / 'otf_core' / 'test'))

import mutations


def memory() -> float:
    """Highest resident memory so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


def main() -> int:
    """Run all kinds, or those named; 1 if anything was wrong."""
    logging.disable()
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 20261122
    wrong = 0
    print('| input | n | troubles | slowest of 1000, CPU s | memory before and after, MB |')
    print('|---|---|---|---|---|')
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        readers = mutations.readers(folder)
        for kind in sys.argv[3:] or readers:
            before, slowest, found = memory(), 0.0, None
            file = folder / f'bad.{kind.rpartition(".")[2]}'
            for block in range(max(1, count // 1000)):
                started = time.process_time()
                found = mutations.look_for_trouble(
                    readers[kind], file, min(count, 1000), seed + block
                )
                slowest = max(slowest, time.process_time() - started)
                if found:
                    wrong += 1
                    break
            told = f'{found[0]}; input {found[1][:200]!r}' if found else '0'
            memories = f'{before:.0f}, {memory():.0f}'
            print(f'| {kind} | {count} | {told} | {slowest:.1f} | {memories} |', flush=True)
    return 1 if wrong else 0


if __name__ == '__main__':
    raise SystemExit(main())

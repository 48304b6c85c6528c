# SPDX-License-Identifier: Apache-2.0
"""Share of ambiguities that a plan after a diagnosis resolves: diagnose, plan, measure, diagnose.

Cells of the simulator with one cause each, driven once at one feed so that some causes are not
told from others. A cause that was named with rivals: `./otf plan --after` plans a further run,
that run is simulated on the same machine, and both are diagnosed together. Resolved: the true
cause is named and none of the rivals is left. Odds: the smallest that the plan foretold.

Usage: PYTHONPATH=src/otf_core python bench/plan_after.py [FIRST_SEED [CAUSE ...]]
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import yaml

from otf_core.cli import main as otf
from otf_core.sim.bag_files import TABLES_FILE

MACHINE = {
    'name': 'bench',
    'chain': 'w-b-X-Y-Z-t',
    'axes': {
        'X': {'min': 0.0, 'max': 0.3, 'table_pitch': 0.05},
        'Y': {'min': 0.0, 'max': 0.25, 'table_pitch': 0.05},
        'Z': {'min': -0.2, 'max': 0.0, 'table_pitch': 0.05},
    },
    'target_offset': [0.0, 0.0, -0.15],
    'tracker': {'u_range': 0.5e-6, 'u_angle': 2.0e-6},
}
CAUSES: dict[str, dict[str, float]] = {
    'servo_mismatch': {'T_X': 2.0e-5, 'T_Y': -1.0e-5},
    'backlash': {'B_X': 2.5e-6, 'B_Z': -1.5e-6},
    'cyclic_error': {'period': 0.01, 'S_Y': 1.5e-6},
    'thermal_axis_expansion': {'tau': 80.0, 'S_Y': 1.5e-5},
    'thermal_structure_drift': {'tau': 60.0, 'D_Z': 4e-6, 'D_X': -2e-6},
    'vibration': {'frequency': 7.0, 'S_Z': 1.5e-6, 'S_X': 1.0e-6},
}
ONE_FEED = 'passes: 1\nlevels: 2\nfeed: 0.2\nrate: 100\n'
BUDGET = '240'


def run(*words: str) -> dict[str, Any]:
    """Run a command and return its object."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        otf([*words, '--json'])
    return json.loads(out.getvalue())


def rivals(folder: Path, cause: str) -> list[str] | None:
    """What a diagnosis did not tell a cause from; None where it does not name it."""
    gap = json.loads((folder / 'gap.json').read_text(encoding='utf-8'))
    for found in gap['causes']:
        if cause in (found['effect'], *found['indistinguishable_from']):
            everything = {found['effect'], *found['indistinguishable_from']}
            return sorted(everything - {cause})
    return None


def circle(cause: str, seed: int, folder: Path) -> str:
    """One cell; a row of the table."""
    machine, effects = folder / 'machine.yaml', folder / 'effects.yaml'
    machine.write_text(yaml.safe_dump(MACHINE))
    effects.write_text(yaml.safe_dump([{'effect': cause, 'parameters': CAUSES[cause]}]))
    cell = ('--machine', str(machine), '--effects', str(effects))
    first, second = folder / 'first', folder / 'second'
    (folder / 'one_feed.yaml').write_text(ONE_FEED)
    once = ('--config', str(folder / 'one_feed.yaml'), '--seed', str(seed))
    run('simulate', *cell, '--out', str(first), *once)
    known = ('--machine', str(machine))
    run('diagnose', str(first), *known, '--out', str(folder / 'diagnosis'))
    before = rivals(folder / 'diagnosis', cause)
    if not before:
        return f'| `{cause}` | {"not named" if before is None else "told at once"} | | |'
    plan = folder / 'plan'
    after = ('--after', str(folder / 'diagnosis'), '--time-budget', BUDGET)
    run('plan', *known, *after, '--out', str(plan))
    asked = json.loads((plan / 'plan.json').read_text(encoding='utf-8'))['after']
    odds = min((a['log_odds'] for a in asked if a['not_told_from']), default=0.0)
    run('simulate', *cell, '--out', str(second), '--seed', str(seed + 500), '--tables',
        str(first / TABLES_FILE), '--path', str(plan / 'plan.json'), '--rate', '100')  # fmt: skip
    run('diagnose', str(first), str(second), *known, '--out', str(folder / 'joint'))
    left = rivals(folder / 'joint', cause)
    said = 'yes' if left == [] else 'not named' if left is None else f'no: {", ".join(left)}'
    return f'| `{cause}` | {", ".join(before)} | {odds:.1f} | {said} |'


def main(words: list[str]) -> None:
    """Drive the circle for every cause."""
    seed = int(words[0]) if words else 41001
    for k, cause in enumerate(words[1:] or CAUSES):
        with tempfile.TemporaryDirectory() as folder:
            print(circle(cause, seed + k, Path(folder)), flush=True)


if __name__ == '__main__':
    main(sys.argv[1:])

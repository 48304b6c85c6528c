# SPDX-License-Identifier: Apache-2.0
"""Picture of the README: error arrows in the volume of a simulated machine, before and after.

Same cell as ``./otf demo``, another seed. Both fields are true errors less predicted ones, with
the best rigid motion taken out, drawn at the same magnification.

Usage: PYTHONPATH=src/otf_core python bench/readme_picture.py [SEED]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.calibration.calibrate import calibrate
from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.files.writing import write_text
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.kinematics import displacement, exact_position
from otf_core.model.machine import load_machine
from otf_core.planning.path_creation import plan_path
from otf_core.sim.cell import simulate

Array = NDArray[np.float64]

ROOT = Path(__file__).parent.parent
MACHINE = ROOT / 'src/otf_bringup/config/machine.yaml'
PICTURE = ROOT / 'docs/images/before_after.svg'
MAGNIFICATION = 500
POINTS = 5
SCALE = 490.0
"""Picture units per m."""
WIDTH, HEIGHT = 880, 400
COLOURS = ('#d55e00', '#0072b2')
HEAD = 3.2
EDGES = ((0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7),
         (6, 7))  # fmt: skip


def flat(points: Array) -> Array:
    """Parallel projection of (n, 3) to (n, 2), picture units, downwards positive."""
    right = points[:, 0] + 0.42 * points[:, 1]
    down = -points[:, 2] - 0.30 * points[:, 1]
    return SCALE * np.stack([right, down], axis=1)


def arrow(a: Array, b: Array) -> str:
    """Path of one arrow; a dot where it is too short for a head."""
    step = b - a
    length = float(np.linalg.norm(step))
    if length < 1.0:
        return f'M{a[0]:.1f} {a[1]:.1f}h.01'
    along = step / length * min(HEAD, length)
    side = np.array([-along[1], along[0]]) * 0.6
    p, q = b - along + side, b - along - side
    return (
        f'M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}'
        f'M{p[0]:.1f} {p[1]:.1f}L{b[0]:.1f} {b[1]:.1f}L{q[0]:.1f} {q[1]:.1f}'
    )


def panel(q: Array, field: Array, left: float, colour: str, title: str) -> list[str]:
    """One box of arrows with its title."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    box = flat(q.min(axis=0) + corners * (q.max(axis=0) - q.min(axis=0)))
    shift = np.array([left, HEIGHT - 40]) - [box[:, 0].min(), box[:, 1].max()]
    start, end = flat(q) + shift, flat(q + MAGNIFICATION * field) + shift
    lines = ''.join(
        f'M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}'
        for a, b in ((box[i] + shift, box[j] + shift) for i, j in EDGES)
    )
    arrows = ''.join(arrow(a, b) for a, b in zip(start, end, strict=True))
    return [
        f'<path d="{lines}" stroke="#bbb" fill="none"/>',
        f'<path d="{arrows}" stroke="{colour}" stroke-width="1.8" stroke-linecap="round" '
        f'fill="none"/>',
        f'<text x="{left}" y="34" font-size="19" fill="{colour}">{title}</text>',
    ]


def main(seed: int = 20_260_021) -> None:
    machine = load_machine(MACHINE)
    plan = plan_path(machine, PlannerConfig())
    run = simulate(machine, plan, SimulationConfig(seed=seed, error_size=1e-4))
    tables = calibrate(run.samples, plan.path, machine).tables
    fine, q = lattice(machine), lattice(machine, POINTS)

    def left(points: Array, compensated: bool) -> Array:
        error = exact_position(run.truth, points) - points
        error -= displacement(tables, points) if compensated else 0.0
        return without_rigid_motion(error, points)

    size = [1e6 * mean_length(left(fine, k)) for k in (False, True)]
    titles = (
        f'before: mean error {size[0]:.0f} \u00b5m',
        f'after compensation: {size[1]:.2f} \u00b5m',
    )
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'font-family="sans-serif">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" rx="8" fill="#fff"/>',
    ]
    for k in range(2):
        parts += panel(q, left(q, bool(k)), 24 + 438 * k, COLOURS[k], titles[k])
    size_mm = ' x '.join(f'{1e3 * v:.0f}' for v in machine.upper - machine.lower)
    parts.append(
        f'<text x="24" y="{HEIGHT - 14}" font-size="13" fill="#555">volume {size_mm} mm; arrows '
        f'{MAGNIFICATION} times as long as the errors in both pictures; simulated machine</text>'
    )
    write_text(PICTURE, '\n'.join([*parts, '</svg>', '']))
    print(f'{PICTURE}: grid error {size[0]:.2f} um before, {size[1]:.3f} um after, seed {seed}')


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))

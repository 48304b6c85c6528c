# SPDX-License-Identifier: Apache-2.0
"""Volumetric errors along a line of the part, and the positions to program instead.

python examples/predict_at_points.py [error_tables.json]
"""

import sys
from pathlib import Path

import numpy as np

import otf_core

BAGS = Path(__file__).resolve().parents[1] / 'bags' / 'y-carries-the-table'
file = sys.argv[1] if len(sys.argv) > 1 else BAGS / 'truth.json'

content = otf_core.load_tables(file)
machine = content.tables.machine
points = np.linspace(machine.lower, machine.upper, 6)  # the space diagonal
there = otf_core.predict(content, points)
for note in there.notes:
    print('note:', note)

print('       x        y        z  |       dx       dy       dz   um')
for q, error in zip(1e3 * points, 1e6 * there.error, strict=True):
    print('{:8.1f} {:8.1f} {:8.1f}  | {:+8.2f} {:+8.2f} {:+8.2f}'.format(*q, *error))

# an error is actual minus nominal: program the nominal position less the error there
program = points - there.error
left = program + otf_core.predict(content, program).error - points
print(f'compensated once: at most {1e6 * np.abs(left).max():.3f} um of the tables are left')

# the same machine with a tool that is 80 mm longer: its rotations reach further
offset = machine.target_offset - np.array([0.0, 0.0, 0.08])
longer = otf_core.predict(content, points, target_offset=offset)
change = np.linalg.norm(longer.error - there.error, axis=1)
print(f'80 mm longer tool: errors change by up to {1e6 * change.max():.2f} um')

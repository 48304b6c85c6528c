# SPDX-License-Identifier: Apache-2.0
"""Are the stated uncertainties right? Simulate a machine whose errors are known, and compare.

python examples/check_the_uncertainty.py
"""

from pathlib import Path

import numpy as np

import otf_core

BAGS = Path(__file__).resolve().parents[1] / 'bags' / 'y-carries-the-table'
machine = otf_core.load_machine(BAGS / 'machine.yaml')

# errors of 50 um; two runs, each from a place of the tracker of its own
cell = otf_core.SimulationConfig(rate=50.0, error_size=5e-5)
first = otf_core.simulate(machine, seed=21, config=cell)
second = otf_core.simulate(machine, seed=22, tables=first.truth, config=cell)
result = otf_core.calibrate([first.recording, second.recording])

# a lattice in the volume; where the machine frame lies exactly is a choice, so that
# a shift and a rotation of the whole volume are no difference
low, high = machine.lower, machine.upper
grid = np.stack(np.meshgrid(*np.linspace(low, high, 5).T), axis=-1).reshape(-1, 3)
found = otf_core.predict(result, grid)
true_error = otf_core.predict(first.truth, grid).error
left = otf_core.without_rigid_motion(found.error - true_error, grid)
before = otf_core.without_rigid_motion(true_error, grid)

mean = [1e6 * np.linalg.norm(field, axis=1).mean() for field in (before, left)]

print(f'mean error in the volume: {mean[0]:.2f} um')
print(f'left after compensation: {mean[1]:.2f} um')
inside = np.abs(left) < 2 * found.u
print(f'stated: {1e6 * found.u.mean():.2f} um in a coordinate (k = 1)')
print(f'components within 2 u: {100 * inside.mean():.0f} %')

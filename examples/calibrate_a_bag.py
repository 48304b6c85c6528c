# SPDX-License-Identifier: Apache-2.0
"""Error tables from a recorded run.

python examples/calibrate_a_bag.py [BAG MACHINE.yaml]; writes the folder results/.
"""

import sys
from pathlib import Path

import otf_core

BAGS = Path(__file__).resolve().parents[1] / 'bags' / 'y-carries-the-table'
bag, description = sys.argv[1:3] if len(sys.argv) > 2 else (BAGS / 'bag', BAGS / 'machine.yaml')

machine = otf_core.load_machine(description)
recording = otf_core.read_bag(bag, machine)
result = otf_core.calibrate(recording)

# a calibration that fails a gate has tables too, but nobody should compensate with them
for gate in result.failed_gates:
    print('do not use:', gate)
for warning in result.warnings:
    print('warning:', warning)

fit = result.fit
print(f'{fit.samples} samples, {100 * fit.coverage:.1f} % of the path driven')
before, after = 1e6 * fit.path_mae_before, 1e6 * fit.path_mae_after
print(f'mean distance from the path: {before:.2f} um, compensated {after:.2f} um')

print('linear positioning error of X:')
table = result.tables.motions['EXX']
for position, value, u in zip(table.position, table.value, table.u, strict=True):
    print(f'  {1e3 * position:8.1f} mm  {1e6 * value:+8.2f} um  u {1e6 * u:.2f} um')
for name, square in result.tables.squareness.items():
    print(f'squareness {name}: {1e6 * square.value:+.2f} urad, u {1e6 * square.u:.2f} urad')

files = otf_core.write_calibration(result, 'results', overwrite=True)
print('written:', ', '.join(str(file) for file in files))

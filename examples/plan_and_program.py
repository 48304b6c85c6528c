# SPDX-License-Identifier: Apache-2.0
"""A path for a machine, what it will show before anything moves, and the NC program.

python examples/plan_and_program.py [MACHINE.yaml]; writes the folder plan/.
"""

import sys
from pathlib import Path

import otf_core

BAGS = Path(__file__).resolve().parents[1] / 'bags' / 'y-carries-the-table'
machine = otf_core.load_machine(sys.argv[1] if len(sys.argv) > 1 else BAGS / 'machine.yaml')

# two laps, the second backwards and slower; the tracker samples 500 times per second
planner = otf_core.PlannerConfig(passes=2, levels=2, feed=0.2, end_dwell=5.0)
tracker = otf_core.ForecastConfig(rate=500.0)
report = otf_core.plan(machine, config=planner, forecast=tracker)

plan, seen = report.plan, report.forecast
print(f'{len(plan.path.points)} points, {plan.path.length:.1f} m, {seen.duration:.0f} s')
print(f'the errors in the volume will be known to {1e6 * seen.mean_grid_u:.2f} um (k = 1)')
print('not seen at all:', ', '.join(seen.not_identifiable) or 'nothing')
for finding in report.findings:
    print(f'not shown: {finding.words}; needs {finding.needs}')
for advice in report.advice:
    print(advice)

files = otf_core.write_plan(report, 'plan', dialect='linuxcnc', overwrite=True)
print('written:', ', '.join(str(file) for file in files))

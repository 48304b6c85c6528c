# SPDX-License-Identifier: Apache-2.0
"""Why does a run depart from its simulation? Here a simulated one, so that the answer is known.

python examples/diagnose_a_run.py
"""

from pathlib import Path

import otf_core

BAGS = Path(__file__).resolve().parents[1] / 'bags' / 'y-carries-the-table'
machine = otf_core.load_machine(BAGS / 'machine.yaml')

# the default path, and 4 um of backlash in X
run = otf_core.simulate(
    machine,
    seed=11,
    effects={'backlash': {'B_X': 4e-6}},
    config=otf_core.SimulationConfig(rate=100.0),
)

diagnosis = otf_core.diagnose(run.recording)
print(diagnosis.verdict, '-', diagnosis.sentence)
gap = diagnosis.gap
print(f'gap {gap.before_um:.2f} um, with the causes {gap.after_um:.2f} um')
for cause in diagnosis.causes:
    print(f'{cause.effect} in {", ".join(cause.axes)}, confidence {cause.confidence:.3f}')
    for name, u in cause.u.items():
        print(f'  {name} = {1e6 * cause.parameters[name]:+.2f} um, u {1e6 * u:.2f} um')

print('what these data cannot show:')
for effect, needs in diagnosis.not_visible:
    print(f'  {effect}; needs {needs}')

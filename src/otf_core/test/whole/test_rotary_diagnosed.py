# SPDX-License-Identifier: Apache-2.0
"""Runs of a machine with rotary axes, from the simulation of an effect to its name."""

import json

import pytest
from rotary_cells import BAG, machine, parts, plan_of

from otf_core.bags.bag import BagContent, write_bag
from otf_core.cli import main
from otf_core.config import SimulationConfig
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.sim.cell import simulate


def run_with(tmp_path, effects, seed=31):
    m = machine()
    config = SimulationConfig(seed=seed, rate=50.0)
    run = simulate(m, plan_of(parts(), dwell=0.5), config, effects=effects)
    write_bag(tmp_path / 'bag', BagContent(run.samples, None))
    yaml, out = str(BAG / 'machine.yaml'), tmp_path / 'out'
    assert main(['diagnose', str(tmp_path / 'bag'), '--machine', yaml, '--out', str(out)]) == 0
    return json.loads((out / 'gap.json').read_text(encoding='utf-8'))


def test_backlash_of_a_rotary_axis_is_named_with_its_size(tmp_path, capsys):
    applied = AppliedEffect(REGISTRY['backlash'], {'B_C': 8e-5, 'held': 1.0})
    gap = run_with(tmp_path, [applied])
    (cause,) = gap['causes']
    assert (cause['effect'], cause['axes'], cause['units']['B_C']) == ('backlash', ['C'], 'rad')
    assert cause['parameters']['B_C'] == pytest.approx(8e-5, abs=3 * cause['u']['B_C'] + 1e-6)
    assert gap['gap']['after_um'] < 0.5 * gap['gap']['before_um']
    assert 'backlash of C' in capsys.readouterr().out

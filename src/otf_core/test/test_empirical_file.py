# SPDX-License-Identifier: Apache-2.0
"""What is wrong in the entry of an empirical effect or any other, and how much is said of it."""

import pytest
from core_cells import some_machine

from otf_core.effects.effects_yaml import effects_from_data
from otf_core.errors import ConfigError


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'acts_as': 'wobble'}, "acts_as: 'wobble' is unknown"),
        ({'nodes': {'moon': [0, 1]}}, "input 'moon' is unknown"),
        ({'nodes': {'time': [1, 0]}}, 'must be ascending'),
        ({'nodes': {'time': [0.0, 0.0]}}, 'too close'),
        ({'table': {'along': [1.0]}}, 'expected 2 finite numbers'),
        ({'table': {'along': [0.0, 1e-6], 'y': [0.0, 1e-6]}}, "'y' is unknown; possible: along"),
        ({'direction': [0, 0, 0]}, 'not all zero'),
    ],
)
def test_what_is_wrong_in_a_table_is_named(change, words):
    entry = {
        'effect': 'empirical', 'acts_as': 'direction', 'direction': [0, 0, 1],
        'nodes': {'time': [0.0, 10.0]}, 'table': {'along': [0.0, 1e-6]},
    }  # fmt: skip
    with pytest.raises(ConfigError, match=words):
        effects_from_data([entry | change], 'file', some_machine())


BACKLASH = {'effect': 'backlash', 'parameters': {'B_X': 1e-6}}
TABLE = {
    'effect': 'empirical', 'acts_as': 'vector', 'nodes': {'time': [0.0, 1.0]},
    'table': {'X': [0.0, 1e-6]},
}  # fmt: skip
ENDLESS = 'b[' * 50_000


@pytest.mark.parametrize(
    'entry',
    [
        BACKLASH | {'effect': ENDLESS},
        BACKLASH | {'form': ENDLESS},
        BACKLASH | {'parameters': {ENDLESS: 1e-6}},
        BACKLASH | {'parameters': {ENDLESS: 'a'}},
        BACKLASH | {'units': {ENDLESS: 'm'}},
        BACKLASH | {ENDLESS: 1},
        BACKLASH | {'form': 'free', 'inputs': {ENDLESS: [0, 1]}},
        TABLE | {'acts_as': ENDLESS},
        TABLE | {'nodes': {ENDLESS: [0, 1]}},
        TABLE | {'nodes': {'near:0,0,' + 100_000 * '0': [0, 0]}},
        TABLE | {'table': {ENDLESS: [0, 1]}},
    ],
)
def test_endless_names_are_said_in_short(entry):
    with pytest.raises(ConfigError) as problem:
        effects_from_data([entry], 'file', some_machine())
    assert len(str(problem.value)) < 1000

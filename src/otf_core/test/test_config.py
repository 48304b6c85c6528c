# SPDX-License-Identifier: Apache-2.0
"""Parameters: types, bounds and choices; every field says what it means."""

import dataclasses

import pytest

from otf_core.config import (
    CalibrationConfig,
    Parameters,
    PlannerConfig,
    SimulationConfig,
    parameter,
)
from otf_core.errors import ConfigError

KINDS = [CalibrationConfig, PlannerConfig, SimulationConfig]
FIELDS = [(kind, info) for kind in KINDS for info in kind.infos()]
NAMES = [f'{kind.__name__}.{info.name}' for kind, info in FIELDS]


@dataclasses.dataclass(frozen=True)
class Sample(Parameters):
    """One parameter of each type."""

    length: float = parameter(0.5, 'a length', 'm', 0.0, 1.0)
    count: int = parameter(3, 'a count', '', 1, 9)
    mode: str = parameter('fast', 'a choice', choices=('fast', 'slow'))
    active: bool = parameter(True, 'a switch')


@pytest.mark.parametrize(('kind', 'info'), FIELDS, ids=NAMES)
def test_parameter_has_meaning_bounds_and_a_default_within(kind, info):
    assert len(info.meaning) > 10
    if isinstance(info.default, (int, float)) and not isinstance(info.default, bool):
        assert info.low <= info.default <= info.high
    assert getattr(kind(), info.name) == info.default


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'length': '0.5'}, 'length:'),
        ({'length': None}, 'length:'),
        ({'length': True}, 'length:'),
        ({'length': float('nan')}, 'length: nan is not finite'),
        ({'length': float('inf')}, 'length: inf is not finite'),
        ({'length': [0.5]}, 'length:'),
        ({'count': 2.0}, 'count:'),
        ({'count': True}, 'count:'),
        ({'count': '2'}, 'count:'),
        ({'mode': 'medium'}, 'mode:'),
        ({'mode': 1}, 'mode:'),
        ({'active': 1}, 'active:'),
        ({'active': 'yes'}, 'active:'),
    ],
)
def test_value_of_wrong_type_or_choice_is_refused(change, reason):
    with pytest.raises(ConfigError, match=reason):
        Sample(**change)


def test_whole_number_becomes_a_float_where_one_is_meant():
    value = Sample(length=1).length
    assert value == 1.0
    assert isinstance(value, float)

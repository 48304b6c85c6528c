# SPDX-License-Identifier: Apache-2.0
"""Error motions by their ISO 230-1 symbols: plain strings that know their parts."""

import copy
import json
import pickle

import pytest

from otf_core.model.motions import MOTIONS, ErrorMotion, unit_of


@pytest.mark.parametrize(
    ('symbol', 'unit', 'positioning', 'straightness', 'along', 'place'),
    [
        ('EXX', 'm', True, False, 0, 0),
        ('EZY', 'm', False, True, 2, 1),
        ('EAZ', 'rad', False, False, 0, 2),
        ('ECX', 'rad', False, False, 2, 0),
    ],
)
def test_symbol_holds_direction_and_axis(symbol, unit, positioning, straightness, along, place):
    motion = ErrorMotion.of(symbol)
    assert motion == symbol and f'{motion}' == symbol and hash(motion) == hash(symbol)
    assert (motion.unit, motion.along, motion.place) == (unit, along, place)
    assert (motion.is_positioning, motion.is_straightness) == (positioning, straightness)
    assert unit_of(symbol) == unit


def test_eighteen_motions_axis_by_axis():
    assert len(set(MOTIONS)) == 18
    assert MOTIONS[:6] == ('EXX', 'EYX', 'EZX', 'EAX', 'EBX', 'ECX')


def test_copies_and_files_keep_it():
    motion = ErrorMotion('B', 'Y')
    for again in (copy.deepcopy(motion), pickle.loads(pickle.dumps(motion))):
        assert again == motion and (again.direction, again.axis) == ('B', 'Y')
    assert json.dumps({motion: 1}) == '{"EBY": 1}'
    assert unit_of('C0Y') == 'rad'

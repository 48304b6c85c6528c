# SPDX-License-Identifier: Apache-2.0
"""Moves that a diagnosis explains by a cycle are said to be explained, others are not."""

import pytest

from otf_core.diagnosis.answer import WORDS, qualify_moves
from otf_core.diagnosis.cause_parameters import Curve
from otf_core.diagnosis.weighing import Unnamed
from otf_core.pieces.finding import GATE, WARNING, Finding

MOVE = Finding('moved', WARNING, 'tracker or target moved 412.2 s after the start')
NOISE = Finding('noise', WARNING, 'louder than specified')


def unnamed(*inputs, before_um=5.8, after_um=0.4):
    """A cause without a name that depends on some inputs."""
    curves = tuple(
        Curve('X', 'X', name, '', (0.0, 1.0), (-1e-6, 1e-6), (1e-7, 1e-7), 'm', {})
        for name in inputs
    )
    share = 100.0 * (1.0 - after_um / before_um)
    words = 'over and over'
    return Unnamed(('time',), 'vector', words, before_um, after_um, share, (share, share), curves)


def test_a_cycle_that_leaves_hardly_anything_explains_a_move():
    told = qualify_moves([NOISE, MOVE], unnamed('cycle:51.1'))
    assert told == (NOISE, Finding('moved', WARNING, MOVE.words + WORDS))


@pytest.mark.parametrize(
    'cause',
    [
        None,
        unnamed('time'),
        unnamed('after:412.2'),
        unnamed('cycle:51.1', 'after:412.2'),
        unnamed('cycle:51.1', after_um=3.0),
    ],
    ids=['a cause with a name', 'time', 'a jolt', 'a cycle and a jolt', 'half of the gap'],
)
def test_nothing_else_explains_a_move(cause):
    assert qualify_moves([MOVE, NOISE], cause) == (MOVE, NOISE)


def test_a_run_that_cannot_be_mended_stays_one():
    broken = Finding('moved', GATE, 'one of the two parts does not determine the tracker pose')
    assert qualify_moves([broken], unnamed('cycle:51.1')) == (broken,)

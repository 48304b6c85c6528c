# SPDX-License-Identifier: Apache-2.0
"""A table pitch finer than the data can follow is reported before anything is solved."""

import logging

import pytest
from core_cells import some_machine

from otf_core.contradictions.table_checks import check_table_pitch
from otf_core.errors import ConfigError


def test_a_usual_pitch_is_no_matter(caplog):
    assert check_table_pitch(some_machine(pitch=0.05), 0.008) == ''
    assert not caplog.records


def test_nodes_closer_than_a_piece_are_a_warning_at_once(caplog):
    with caplog.at_level(logging.WARNING, 'otf_core'):
        words = check_table_pitch(some_machine(pitch=0.005), 0.008)
    assert 'X 5 mm (61 nodes)' in words and 'finer than the 8 mm' in words
    assert [r.getMessage() for r in caplog.records] == [words]


def test_a_slip_of_the_pen_that_would_never_end_is_refused_with_a_pitch_that_ends():
    with pytest.raises(ConfigError) as caught:
        check_table_pitch(some_machine(pitch=0.0005), 0.008)
    said = str(caught.value)
    assert said.startswith('axes: table_pitch: X 0.5 mm (601 nodes)')
    assert 'or is it in another unit?' in said
    wide = float(said.split('a table_pitch of ')[1].split(' mm')[0])
    check_table_pitch(some_machine(pitch=1e-3 * wide), 0.008)

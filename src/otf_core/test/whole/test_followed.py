# SPDX-License-Identifier: Apache-2.0
"""Fine functions of a calibration do not hide what lies at fixed places of an axis."""

import numpy as np
import pytest
from nature import NAMES, Cell

from otf_core.calibration.calibrate import solve_recordings
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.engine.diagnosed_rows import rows_to_diagnose
from otf_core.diagnosis.engine.search import search, tried_effects
from otf_core.effects import REGISTRY
from otf_core.solving.model_choice import is_finer
from otf_core.solving.unknowns import LINEAR

CONFIG = CalibrationConfig(piece_length=0.015, reversal='none')
PITCH = 0.05
AMPLITUDE = 6e-6
RIVALS = ('table_resolution', 'cross_coupling', 'backlash', 'table_tilt')


def with_waves(motions, wave, form='polygon'):
    """A cell in which some motions have short waves beside their own form."""
    cell = Cell(3, size=(0.3, 0.25, 0.2), pitch=PITCH, form=form, path='short', passes=1)
    for name in motions:
        own = cell.curves[name]
        cell.curves[name] = lambda q, own=own: own(q) + AMPLITUDE * wave(q)
    return cell


def bows(q):
    """A parabola in every interval of the table, up and down in turn: zero at the nodes."""
    s = q / PITCH - np.floor(q / PITCH)
    return 4.0 * s * (1.0 - s) * np.where(np.floor(q / PITCH) % 3 == 0, -1.0, 1.0)


def ripple(q):
    """Waves that smooth functions over 20 parts cannot follow."""
    return np.sin(2.0 * np.pi * q / 0.027 + 0.7)


@pytest.fixture(scope='module')
def bowed():
    return solved(with_waves(['EYX'], bows))


def solved(cell):
    found = solve_recordings([cell.recording(60.0)], CONFIG)
    kept, done = found.solution.plain
    assert is_finer(done.unknowns.bases)
    return kept, done, found.nodes, CONFIG


def degrees(rows):
    return {basis.degree for basis in rows.done.unknowns.bases.values()}


def test_what_tables_leave_between_nodes_is_found_with_its_motion(bowed):
    rows = rows_to_diagnose(*bowed, ())
    assert degrees(rows) == {LINEAR}
    tried, _ = tried_effects(rows, [REGISTRY[name] for name in RIVALS], {})
    cause = search(rows, tried)[0][0].option
    assert cause.effect.name == 'table_resolution'
    assert {cause.terms.names[k].partition('@')[0] for k in cause.take} == {'EYX'}


def test_without_these_effects_the_functions_are_those_of_the_calibration(bowed):
    rows = rows_to_diagnose(*bowed, ('table_resolution', 'cyclic_error'))
    assert is_finer(rows.done.unknowns.bases)


def test_short_waves_in_all_motions_are_the_machine_itself():
    rows = rows_to_diagnose(*solved(with_waves(NAMES, ripple, 'waves')), ())
    assert is_finer(rows.done.unknowns.bases)

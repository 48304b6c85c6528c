# SPDX-License-Identifier: Apache-2.0
"""What motions that were seen say of places and motions that no data hold."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import some_machine, zero_tables

from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.nodes import table_nodes
from otf_core.model.tables import Squareness
from otf_core.solving.model_choice import smooth_bases
from otf_core.solving.tabulate import USUAL_ANGLE, prior_of
from otf_core.solving.unknowns import layout

LIMIT = 1e-4
LOGS = np.log([0.04, 0.25, 1e-4])  # 20 um, a quarter of the range


def solved(seen, squareness=SQUARENESS):
    """A solution that sees some motions, all with the same roughness; tables of slope 1e-4."""
    machine = some_machine()
    unknowns = layout(smooth_bases(table_nodes(machine, machine.lower, machine.upper)))
    tables = zero_tables(machine)
    motions = {}
    for name, table in tables.motions.items():
        value = 1e-4 * (table.position - table.position[0]) if name in seen else 0 * table.value
        motions[name] = replace(table, value=value)
    tilts = {n: Squareness(3e-5 if n in squareness else 0.0) for n in SQUARENESS}
    done = SimpleNamespace(
        unknowns=unknowns,
        roughness=SimpleNamespace(logs=dict.fromkeys(seen, LOGS)),
        solution=SimpleNamespace(accepted=(*squareness, *seen)),
    )
    return done, replace(tables, motions=motions, squareness=tilts)


def test_a_motion_goes_on_with_its_own_slope_and_waves():
    prior = prior_of(*solved(MOTIONS), LIMIT)
    assert set(prior) == set(MOTIONS)
    assert prior['EXX'].slope == pytest.approx(1e-4)
    assert prior['EAX'].slope == pytest.approx(1e-4)
    assert prior['EYX'].slope == 0.0  # that of a straightness lies in squareness
    for name, span in (('EXX', 0.3), ('ECY', 0.25)):
        assert prior[name].sd == pytest.approx(2e-5)
        assert prior[name].length == pytest.approx(0.25 * span)
        assert prior[name].intensity == pytest.approx(1e-12 / span**3)


def test_what_is_not_seen_is_taken_to_be_like_what_is():
    """Z does not move: nothing is known of its motions, or of the squareness to it."""
    seen = tuple(m for m in MOTIONS if m[2] != 'Z')
    prior = prior_of(*solved(seen, ('C0Y',)), LIMIT)
    assert set(prior) == {*MOTIONS, 'B0Z', 'A0Z'}
    assert prior['EZZ'].slope == pytest.approx(1e-4)
    assert prior['EXZ'].slope == 0.0
    for name in ('EXZ', 'EYZ', 'EZZ'):
        assert prior[name].sd == pytest.approx(2e-5)
        assert 0.25 * 0.25 < prior[name].length < 0.25 * 0.3
    for name in ('EAZ', 'EBZ', 'ECZ'):
        assert prior[name].slope == pytest.approx(1e-4)
        # tables of two nodes: 0 and slope times range
        assert prior[name].sd == pytest.approx(1e-4 * np.sqrt((0.3**2 + 0.25**2) / 4))
    assert prior['B0Z'].sd == pytest.approx(3e-5)


def test_where_nothing_is_seen_the_usual_is_taken():
    prior = prior_of(*solved((), ()), LIMIT)
    assert set(prior) == {*MOTIONS, *SQUARENESS}
    assert prior['EAZ'].sd == prior['C0Y'].sd == prior['EXX'].slope == USUAL_ANGLE


def test_uncertainty_beyond_the_ends_grows_with_the_distance():
    prior = prior_of(*solved(MOTIONS), LIMIT)
    found = prior['EXX'].beyond(np.array([-0.1, 0.0, 0.01, 0.1, 0.3]))
    assert np.all(found[:2] == 0.0)
    assert np.all(np.diff(found[1:]) > 0)
    # waves of 20 um have forgotten the end there: root of 2 of them, and slope times distance
    assert found[-1] == pytest.approx(
        2 * 2e-5**2 + (1e-4 * 0.3) ** 2 + 1e-12 / 0.3**3 * 0.3**3 / 3, rel=1e-3
    )

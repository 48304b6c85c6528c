# SPDX-License-Identifier: Apache-2.0
"""Which inputs and ways to act belong to which effect of the catalogue."""

import pytest

from otf_core.effects import REGISTRY
from otf_core.effects.action import Along, rigid_table, rigid_tracker, vector
from otf_core.effects.cause_names import NAMES, name_of

ALONG_X, ALONG_Z = Along((0.99, 0.1, 0.1)), Along((0.1, 0.1, 0.99))


def test_names_are_those_of_the_catalogue():
    assert {line.name for line in NAMES} <= set(REGISTRY)


@pytest.mark.parametrize(
    ('inputs', 'acts', 'name'),
    [
        (('x',), rigid_table, 'table_tilt'),
        (('z',), rigid_tracker, 'table_tilt'),
        (('time',), rigid_tracker, 'tracker_pose_drift'),
        (('signal:/room',), rigid_table, 'tracker_pose_drift'),
        (('lap',), rigid_tracker, 'tracker_pose_drift'),
        (('x', 'z'), vector, 'cross_coupling'),
        (('y', 'z'), ALONG_Z, 'cross_coupling'),
        (('sense_x',), ALONG_X, 'backlash'),
        (('since_reversal_z',), ALONG_Z, 'backlash'),
        (('sense_x', 'x'), ALONG_X, 'direction_dependent_tables'),
        (('time', 'z'), ALONG_Z, 'thermal_axis_expansion'),
    ],
)
def test_what_depends_and_acts_as_an_effect_has_its_name(inputs, acts, name):
    found, words = name_of(inputs, acts)
    assert found == name and words


@pytest.mark.parametrize(
    ('inputs', 'acts'),
    [
        (('x',), vector),  # straightness, which tables hold
        (('after:12',), rigid_tracker),  # a knock
        (('cycle:30',), rigid_tracker),
        (('time', 'x'), ALONG_Z),  # a bed that sags, no axis that grows
        (('time', 'x'), rigid_table),
        (('sense_x',), ALONG_Z),
        (('sense_x', 'z'), ALONG_X),
        (('azimuth', 'elevation'), vector),
        (('feed',), vector),
    ],
)
def test_what_depends_or_acts_otherwise_has_none(inputs, acts):
    assert name_of(inputs, acts) == ('', '')

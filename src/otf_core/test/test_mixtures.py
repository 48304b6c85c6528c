# SPDX-License-Identifier: Apache-2.0
"""Two target offsets that differ in general directions: which motions hold shares of others."""

from core_cells import some_machine

from otf_core.calibration.assembly import mixture_warnings

CHAIN = 'w-Y-X-b-Z-t'


def warned(*offsets, hidden=('ECX', 'ECZ')):
    return mixture_warnings([some_machine(CHAIN, offset=own) for own in offsets], hidden)


def test_a_line_between_targets_in_general_direction_leaves_a_mixture():
    (words,) = warned((0.08, -0.05, -0.25), (-0.1, 0.07, -0.1))
    assert words.startswith('EAZ and EBZ contain a share of ECZ')  # the lever of X holds Y as well


def test_targets_along_a_machine_axis_leave_one_motion_unseen():
    assert warned((0.08, -0.05, -0.25), (0.08, -0.05, -0.1)) == []


def test_one_target_and_three_leave_no_mixture():
    assert warned((0.08, -0.05, -0.25), hidden=('EAZ', 'EBZ', 'ECZ')) == []
    assert warned((0.08, -0.05, -0.25), (-0.1, 0.07, -0.1), (0.1, 0.1, 0.0), hidden=()) == []

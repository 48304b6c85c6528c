# SPDX-License-Identifier: Apache-2.0
"""Where a gap lies, in the view that separates it most: known places on plain arrays."""

import numpy as np
import pytest
from gap_cells import SIZE, along, run_view

from otf_core.diagnosis.place.placement import separations
from otf_core.diagnosis.place.where import components, total_group, where_and_shape

YZ = [[0, 1, 1], [0, 0, 0], [1, 0, 1], [0, 0, 0], [0, 1, 1], [0, 0, 0], [0, 0, 1], [0, 1, 0],
      [0, 0, 1], [1, 0, 0], [0, 0, 1], [0, 1, 0]]  # fmt: skip
"""Diagonals of Y and Z, and of X and Z, beside those of the path."""
KNOWN = 'like that of backlash (X) along X'


def view_of(gap, **further):
    return run_view(gap, feed=0.25, **further)


def moves(view, axis):
    return np.abs(view.direction[:, axis]) > 0.05


def sense(view, axis):
    return np.where(moves(view, axis), np.sign(view.direction[:, axis]), 0.0)


def far(view):
    flip = np.where(view.leg % 2 > 0, 1.0, -1.0)
    shift = (np.linalg.norm(view.beam, axis=1) > 1.3) * flip * 2.5e-6
    return shift[:, None] * np.array([0.6, 0.6, 0.5])


def where_of_known(*views):
    return where_and_shape(views, known=KNOWN)[0]


@pytest.mark.parametrize(
    ('gap', 'view', 'grouping', 'words'),
    [
        (
            lambda v: along(0, 3e-6 * sense(v, 0)), 'path', 'lines',
            ('on the diagonals that move X, in both senses with opposite signs',
             'nothing beyond noise on lines along X, Y or Z or on diagonal YZ'),
        ),
        (
            lambda v: along(2, 3e-6 * moves(v, 0)), 'path', 'lines',
            ('wherever X moves', 'nothing beyond noise on lines along Y or Z or on diagonal YZ'),
        ),
        (
            lambda v: along(2, 4e-6 * (sense(v, 0) > 0)), 'path', 'sense of X',
            ('when X moves forward', 'nothing beyond noise elsewhere'),
        ),
        (
            lambda v: along(1, 4e-6 * (v.q[:, 0] > 0.5)), 'volume', 'position of X',
            ('where X is above 500 mm', 'nothing beyond noise elsewhere'),
        ),
        (
            lambda v: along(2, 5e-6 * ((v.q[:, 0] > 0.45) & (v.q[:, 1] < 0.125))), 'volume',
            'position of X and Y', ('where X is above 450 mm and Y is below 125 mm',),
        ),
        (
            lambda v: along(2, 3e-6 * (v.time > 200.0)), 'time', 'time',
            ('after 2', ' s ('),
        ),
        (far, 'beam', 'distance', ('far from the tracker (beyond 1',)),
    ],
    ids=['diagonals', 'lines', 'sense', 'slice', 'region', 'time', 'far'],
)  # fmt: skip
def test_place_is_said_in_the_view_that_separates_most(gap, view, grouping, words):
    where = where_of_known(view_of(gap, more=YZ))
    assert (where.view, where.grouping) == (view, grouping), where.separation[:4]
    assert where.summary.startswith('The gap lies ')
    assert all(word in where.summary for word in words), where.summary


def test_moment_is_that_of_the_window_in_which_it_begins():
    view = view_of(lambda v: along(2, 3e-6 * (v.time > 200.0)))
    start = float(where_of_known(view).summary.split('after ')[1].split(' s')[0])
    assert start == pytest.approx(200.0, abs=np.ptp(view.time) / 12.0)


def test_summary_is_no_tautology():
    """That the gap lies as of its cause says nothing."""
    for gap in (far, lambda v: along(0, 3e-6 * sense(v, 0))):
        words = where_of_known(view_of(gap)).summary
        assert 'as of' not in words and 'backlash' not in words and 'Where and how' not in words


def test_what_lies_everywhere_alike_has_no_place():
    """A shift to and fro with the legs, whatever they are."""
    flip = np.random.default_rng(3).choice([-1.0, 1.0], 1000)
    where = where_of_known(view_of(lambda v: np.outer(flip[v.leg], [2e-6, 2e-6, 2e-6])))
    assert (where.view, where.grouping, where.parts) == ('', '', ())
    assert where.summary.startswith('The gap lies all over the run')


@pytest.mark.parametrize('seed', range(4))
def test_noise_has_no_place(seed):
    view = run_view(None, seed=seed)
    where = where_and_shape([view])[0]
    assert where.view == '' and 'nothing' not in where.summary
    assert 'No place stands out' in where.summary
    assert max(s.share for s in separations([view], [view.residual_before])) < 0.1


def test_shares_of_groups_by_chance_are_about_zero():
    found = []
    for seed in range(6):
        view = run_view(None, seed=40 + seed)
        found += [s.share for s in separations([view], [view.residual_before])]
    assert np.mean(found) == pytest.approx(0.0, abs=0.01)


def test_parts_hold_the_whole_gap_and_the_whole_path():
    parts = where_of_known(view_of(far)).parts
    assert sum(p['share_of_gap_percent'] for p in parts) == pytest.approx(100.0)
    assert sum(p['share_of_path_percent'] for p in parts) == pytest.approx(100.0)


def mixed(view):
    return along(0, 3e-6 * sense(view, 0)) + along(1, 1e-6 * moves(view, 2))


@pytest.mark.parametrize('gap', [mixed, far, lambda v: along(1, 4e-6 * (v.q[:, 0] > 0.5))])
def test_no_component_is_larger_than_the_whole_gap(gap):
    view = view_of(gap)
    total = total_group([view], [view.residual_before])
    found = components([view], [view.residual_before])
    assert sum(v**2 for v in found.values()) == pytest.approx(total.excess)
    assert max(found.values()) <= np.sqrt(total.excess) * (1 + 1e-9)


def test_gap_is_the_one_beside_the_residual_of_the_simulation():
    """Noise counts as much as the simulation leaves: one gap, in rows and components."""
    view, simulated = view_of(mixed), 0.52e-6
    where = where_and_shape([view], known=KNOWN, simulated=simulated)[0]
    measured = float(np.sqrt((view.residual_before**2).sum(axis=0).mean()))
    gap = 1e6 * np.sqrt(measured**2 - simulated**2)
    assert np.sqrt(sum(v**2 for v in where.components_um.values())) == pytest.approx(gap)
    for rows in (where.by_time, where.by_path_piece, where.by_region):
        pieces = np.array([r['pieces'] for r in rows])
        square = np.array([r['rms_um'] ** 2 - r['expected_um'] ** 2 for r in rows])
        assert np.sqrt(pieces @ square / pieces.sum()) == pytest.approx(gap)
    along_axes = [r for r in where.by_axis_and_direction if r['kind'] == 'points']
    assert {r['label'][-1]: r['gap_um'] for r in along_axes} == where.components_um


def test_significance_does_not_depend_on_the_simulation():
    view = view_of(mixed)
    plain, other = (where_and_shape([view], known=KNOWN, simulated=s)[0] for s in (None, 0.45e-6))
    assert [r['significance'] for r in plain.by_time] == [r['significance'] for r in other.by_time]
    assert plain.by_time[0]['expected_um'] != other.by_time[0]['expected_um']


def test_place_of_one_run_of_several_is_named():
    views = [view_of(None, name='first', seed=7), view_of(far, name='second')]
    assert where_of_known(*views).view in ('beam', 'time', 'volume')
    late = view_of(lambda v: along(2, 4e-6 * (v.time > 200.0)), name='second')
    where = where_of_known(views[0], late)
    assert where.view == 'time' and 'second: ' in where.summary and 'first' not in where.summary


def test_volume_of_the_cell_is_in_mm():
    where = where_of_known(view_of(lambda v: along(1, 4e-6 * (v.q[:, 0] > 0.5))))
    assert where.parts[-1]['label'] == f'X 500 mm to {1e3 * SIZE[0]:.0f} mm'


def test_little_is_not_called_nothing():
    """A tenth of the gap that is clearly beyond noise is something."""
    view = view_of(
        lambda v: along(2, 6e-6 * moves(v, 0)) + along(0, 1.6e-6 * (~moves(v, 0))), more=YZ
    )
    words = where_of_known(view).summary
    assert 'wherever X moves' in words and '; little on ' in words and 'nothing' not in words

# SPDX-License-Identifier: Apache-2.0
"""Paths for rotary axes and what they show; judged by the rank condition."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from otf_core.bags.bag import write_axis_paths
from otf_core.bags.bag_reading import BagReading
from otf_core.bags.rosbag2_metadata import PATH, POINT
from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.axis_path import AxisPath
from otf_core.model.chain import Sight
from otf_core.model.machine import machine_from_dict
from otf_core.model.plan import Plan, part_along
from otf_core.planning import chains as paths
from otf_core.planning import line_of_sight as sight
from otf_core.planning.clearance import near_misses
from otf_core.planning.facings import facing_chains
from otf_core.planning.findings import findings
from otf_core.planning.forecast import Setup, forecast
from otf_core.planning.part_choice import choose_parts, work_by_hand

FEED = PlannerConfig(feed=0.1, levels=2)
PLACES = {'a': [0.2, 0.03, 0.1], 'b': [-0.09, 0.16, 0.06], 'c': [-0.07, -0.17, 0.13]}


def trunnion(link='b', nests=3, chain='w-C-A-b-Y-X-Z-t'):
    nest = {n: {'link': 'w', 'place': p, 'u': 1e-3} for n, p in list(PLACES.items())[:nests]}
    linear = {'X': (-0.3, 0.3), 'Y': (-0.25, 0.25), 'Z': (0.0, 0.6)}
    axes = {a: {'min': lo, 'max': hi, 'table_pitch': 0.25} for a, (lo, hi) in linear.items()}
    axes['A'] = {'kind': 'rotary', 'min': -0.5, 'max': 1.9, 'table_pitch': 0.8,
                 'direction': [1, 0, 0], 'centre': [0, 0, 0.05]}  # fmt: skip
    axes['C'] = {'kind': 'rotary', 'min': 0.0, 'max': 6.2832, 'table_pitch': 1.0472,
                 'direction': [0, 0, 1], 'centre': [0, 0, 0], 'endless': True}  # fmt: skip
    axes = {a: own for a, own in axes.items() if a in chain}
    return machine_from_dict({
        'name': 'trunnion', 'chain': chain, 'axes': axes,
        'target_offset': [0.0, 0.0, -0.15],
        'tracker': {'u_range': 5e-7, 'u_angle': 2e-6, 'link': link},
        'targets': {'long': {'link': 't', 'place': [0.0, 0.0, -0.25], 'u': 0.0}}
        | (nest if link == 'b' else {}),
    })  # fmt: skip


def swivel_head():
    """C carries A carries the spindle; lengths and a reflector off its axis."""
    axes = {a: {'min': lo, 'max': hi, 'table_pitch': 0.4}
            for a, lo, hi in (('X', -0.5, 0.5), ('Y', -0.4, 0.4), ('Z', 0.0, 0.6))}  # fmt: skip
    for a, end, direction in (('C', 3.14, [0, 0, 1]), ('A', 1.7, [1, 0, 0])):
        axes[a] = {'kind': 'rotary', 'min': -end, 'max': end, 'table_pitch': 0.8,
                   'direction': direction, 'centre': [0, 0, 0]}  # fmt: skip
    places = {'long': [0.0, 0.0, -0.3], 'side': [0.08, 0.0, -0.2]}
    return machine_from_dict({
        'name': 'head', 'chain': 'w-b-X-Y-Z-C-A-t', 'axes': axes,
        'target_offset': [0.0, 0.0, -0.2], 'tracker': {'u_range': 5e-7, 'u_angle': 2e-6},
        'targets': {n: {'link': 't', 'place': p, 'u': 0.0} for n, p in places.items()},
    })  # fmt: skip


def part(machine, name, *chains):
    q = np.concatenate(chains)
    return part_along(machine, AxisPath(machine.axis_names, q, name), FEED)


def judged(machine, parts):
    """Uncertainties (root mean square over the nodes) and why errors are not seen."""
    plan, setup = Plan(tuple(parts)), Setup.of(machine)
    found = forecast(plan, setup)
    why = {f.error: f'{f.words}; needs {f.needs}' for f in findings(plan, found, setup.limit)}
    hidden = {n: why[n] for n in found.not_identifiable}
    u = {n: float(np.sqrt(np.mean(own**2))) for n, own in found.u.items()}
    return SimpleNamespace(hidden=hidden, u=u)


@pytest.fixture(scope='module')
def lines():
    machine = trunnion()
    box = paths.box_lap(machine, list('XYZ'), 2)
    return [part(machine, name, box) for name in ('tool', 'long')]


def test_circles_alone_hide_angular_positioning_and_say_why(lines):
    machine = trunnion()
    alone = [part(machine, n, paths.turn(machine, 'C'), paths.turn(machine, 'A')) for n in PLACES]
    found = judged(machine, lines + alone)
    assert {'ECC', 'EAA'} <= set(found.hidden)
    assert not {'EXC', 'EYC', 'EZC', 'EAC', 'EBC', 'X0C', 'Y0C'} & set(found.hidden)
    assert 'moves nothing else' in found.hidden['ECC']


@pytest.fixture(scope='module')
def whole():
    machine = trunnion()
    plan = paths.parts_of(machine, paths.candidate_chains(machine, FEED), FEED)
    return plan, judged(machine, plan)


def test_two_rotary_axes_together_leave_only_the_roll_of_the_spindle(whole):
    machine, (plan, found) = trunnion(), whole
    assert set(found.hidden) == {'ECX', 'ECZ'}
    rotary = [p for p in plan if p.path.target in PLACES]
    assert Plan(tuple(rotary)).duration(machine, 2.0) < 600.0
    assert found.u['ECC'] < 5e-6
    assert found.u['EAA'] < 4e-6
    assert found.u['A0C'] < 1.5e-6


def test_a_tracker_on_the_table_sees_all_by_creep():
    machine = trunnion('w')
    plan = paths.parts_of(machine, paths.candidate_chains(machine, FEED), FEED)
    assert {p.path.target for p in plan if 'creep' in p.words} == {'tool'}
    found = judged(machine, plan)
    assert set(found.hidden) == {'ECX', 'ECZ'}
    assert found.u['ECC'] < 2e-6


def test_stops_show_angular_positioning_of_a_single_rotary_axis():
    machine = trunnion(chain='w-C-b-Y-X-Z-t')
    plan = paths.parts_of(machine, paths.candidate_chains(machine, FEED), FEED)
    assert any(p.stops for p in plan)
    assert 'ECC' not in judged(machine, plan).hidden
    without = [p for p in plan if not p.stops]
    assert 'ECC' in judged(machine, without).hidden


def test_creep_moves_the_reflector_along_the_drift_alone():
    machine = trunnion('w')
    start, drift = np.array([0.1, 0.02, 0.1]), np.array([0.0, 0.0, 0.06])
    for axis in ('A', 'C'):
        q = paths.creep(machine, {axis: paths.courses(machine, axis)}, start, drift)
        p = Sight.of_target(machine, 'tool').nominal(q)
        half = len(q) // 2
        expected = start + np.linspace(0.0, 1.0, half + 1)[:, None] * drift
        np.testing.assert_allclose(p[: half + 1], expected, atol=1e-12)
        np.testing.assert_allclose(q, q[::-1], atol=0.0)


def test_a_budget_is_kept_and_spent_on_all_errors_that_can_be_seen():
    machine = trunnion()
    place = sight.default_tracker_place(machine)
    parts = choose_parts(Setup.of(machine), FEED, 1800.0)
    driving = Plan(tuple(parts)).duration(machine, 2.0)
    turns = sum(sight.facings_needed(s) - 1 for s in sight.sights(machine, place).values())
    assert (
        driving + paths.HAND_MOVE * work_by_hand(machine, parts)[0] + sight.HAND_TURN * turns
        <= 1800.0
    )
    found = judged(machine, parts)
    assert set(found.hidden) <= {'ECX', 'ECZ', 'EAZ', 'EBZ', 'EXZ', 'EYZ', 'A0Z', 'B0Z'}
    with pytest.raises(ConfigError, match='the shortest chain alone takes'):
        choose_parts(Setup.of(machine), FEED, 5.0)


def with_facings(machine, count):
    """The same machine with reflectors on the table that are turned by hand."""
    data = machine.to_dict()
    for own in data['targets'].values():
        own |= {'facings': count} if own['link'] == 'w' else {}
    return machine_from_dict(data)


def test_a_reflector_that_is_turned_stays_in_its_cone_from_the_start_of_each_part():
    machine = with_facings(trunnion(), 4)
    assert machine_from_dict(machine.to_dict()).targets == machine.targets
    place = sight.default_tracker_place(machine)
    chains = facing_chains(machine, place)
    assert len({c.target for c in chains}) == 3 * 4
    for chain in chains:
        steps = np.linspace(chain.corners[:-1], chain.corners[1:], 15).reshape(-1, 5)
        beam = sight.beams(machine, chain.target, place, steps)
        assert sight.in_view(machine, chain.target, beam).all()
        aimed = sight.beams(machine, chain.target, place, chain.corners[:1])[0]
        assert np.all(beam @ aimed > np.cos(np.radians(30.0)))


def test_a_swivel_head_shows_all_by_creep_with_its_other_axis_tilted():
    machine = swivel_head()
    chains = paths.candidate_chains(machine, FEED)
    column = machine.column('A')
    upright = [c for c in chains if c.is_lines or not c.corners[:, column].any()]
    found = judged(machine, paths.parts_of(machine, upright, FEED))
    assert {'EAA', 'Y0A'} <= set(found.hidden)
    some = [c for k, c in enumerate(chains) if c.is_lines or k % 6 == 0]
    found = judged(machine, paths.parts_of(machine, some, FEED))
    assert not found.hidden
    for name, most in {'ECC': 5e-6, 'EAA': 5e-6, 'A0C': 1.5e-6}.items():
        assert found.u[name] < most, name


def test_a_spindle_that_passes_a_nest_or_the_tracker_is_named():
    machine = trunnion()
    box = [part(machine, 'tool', paths.box_lap(machine, list('XYZ'), 2))]
    assert near_misses(machine, box, np.array([2.0, 2.0, 1.0])) == []
    data = machine.to_dict()
    data['targets']['a']['place'] = [0.0, 0.0, 0.1]
    data['target_offset'] = [0.0, 0.0, 0.0]
    low = machine_from_dict(data)
    box = [part(low, 'tool', paths.box_lap(low, list('XYZ'), 3))]
    sentences = near_misses(low, box, np.array([2.0, 2.0, 1.0]))
    assert any('mm of a:' in words for words in sentences)
    assert not any('the tracker' in words for words in sentences)
    at = paths.box_lap(low, list('XYZ'), 3)[0, :3]
    assert any('the tracker' in w for w in near_misses(low, box, at))


BOXES = {
    'fixture': {'link': 'w', 'low': [0.0, 0.1, 0.0], 'high': [0.1, 0.2, 0.3]},
    'column': {'link': 'b', 'low': [-0.9, 0.6, 0.0], 'high': [-0.8, 0.7, 2.0]},
    'ram': {'link': 't', 'low': [-0.05, -0.05, 0.0], 'high': [0.05, 0.05, 0.3]},
}


def test_boxes_that_meet_or_stand_in_the_beam_are_named():
    data = trunnion().to_dict() | {'surroundings': {'half_angle': 1.0, 'boxes': BOXES}}
    machine = machine_from_dict(data)
    assert machine_from_dict(machine.to_dict()) is not None
    assert machine.to_dict()['surroundings'] == data['surroundings']
    place = np.array([-1.0, 0.7, 1.0])
    box = [part(machine, 'tool', paths.box_lap(machine, list('XYZ'), 2))]
    words = ' '.join(near_misses(machine, box, place))
    assert 'box fixture to 0 mm of box ram' in words
    assert 'the reflector of the spindle (tool) to 0 mm of box fixture' in words
    assert 'box column stands in the beam to tool' in words
    assert 'column to' not in words
    # the table turns the fixture away from the ram, which waits, and into the beam
    turned = [part(machine, 'a', paths.turn(machine, 'C', Z=0.6))]
    words = ' '.join(near_misses(machine, turned, place))
    assert 'mm of' not in words
    assert 'box fixture stands in the beam to a' in words
    wide, narrow = (sight.sight_share(m, 'a', place) for m in (machine, trunnion()))
    assert wide.facings[1] > narrow.facings[1]


@pytest.mark.parametrize(
    ('section', 'words'),
    [
        ({'half_angle': 60.0}, 'surroundings: half_angle'),
        ({'boxes': {'a': {**BOXES['ram'], 'link': 'x'}}}, "a: link: expected 'w'"),
        ({'boxes': {'a': {**BOXES['ram'], 'high': [0, 0, 0]}}}, 'a: high: .* not above low'),
        ({'box': {}}, 'box: unknown key'),
    ],
)
def test_surroundings_that_cannot_be_are_refused_by_their_key(section, words):
    with pytest.raises(ConfigError, match=words):
        machine_from_dict(trunnion().to_dict() | {'surroundings': section})


def test_tracker_stands_where_the_table_tilts_to():
    machine = trunnion()
    assert sight.default_tracker_place(machine)[1] > 0.25
    other = {**machine.axes, 'A': replace(machine.axes['A'], direction=(-1.0, 0.0, 0.0))}
    assert sight.default_tracker_place(replace(machine, axes=other))[1] < -0.25


def test_the_table_hides_its_reflectors_from_the_other_side():
    machine = trunnion()
    place = sight.default_tracker_place(machine)
    good = sight.sight_share(machine, 'a', place)
    bad = sight.sight_share(machine, 'a', place * [1.0, -1.0, 1.0])
    assert good.open > 0.95 > 0.7 > bad.open
    assert all(a <= b for a, b in zip(good.facings, good.facings[1:], strict=False))
    assert good.facings[-1] > 0.8
    assert good.ranges['A'] == pytest.approx((-0.5, 1.9))
    assert bad.ranges['A'][1] < 1.0


def test_parts_come_back_from_their_file(tmp_path):
    machine = trunnion()
    plan = [p.path for p in paths.parts_of(machine, paths.candidate_chains(machine, FEED), FEED)]
    write_axis_paths(tmp_path / 'path.mcap', plan)
    found = BagReading(tmp_path / 'path.mcap', POINT, PATH).axis_paths
    assert [p.target for p in found] == [p.target for p in plan]
    for one, other in zip(found, plan, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)

# SPDX-License-Identifier: Apache-2.0
"""Inputs that contradict each other are said, not solved; healthy ones are left alone."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from contradiction_cells import (
    CONFIG,
    again,
    asked,
    broken,
    cell,
    mixed,
    recorded,
    spoiled_share,
    stepped,
    warmed,
)  # fmt: skip
from nature import Extra, judge

from otf_core.bags.bag import BagContent, write_bag
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.contradictions.table_checks import check_worth
from otf_core.errors import InputError
from otf_core.model.machine import Axis, Chain, TrackerSpec
from otf_core.model.path import NominalPath
from otf_core.prediction.volumetric import VolumetricError


def with_machine(recording, **fields):
    return replace(recording, machine=replace(recording.machine, **fields))


def with_axis(recording, axis, spec):
    return with_machine(recording, axes={**recording.machine.axes, axis: spec})


def part(recording, low, high, name):
    samples = recording.samples.part(low, high)
    return replace(recording, samples=samples, name=name)


def refused(*recordings):
    with pytest.raises(InputError) as raised:
        asked(*recordings)
    return str(raised.value)


@pytest.mark.parametrize('make', [
    lambda a: [a, again(a)],
    lambda a: [a, part(a, 1000, 5000, 'run 2')],
    lambda a: [part(a, 0, 5000, 'run 1'), part(a, 4000, len(a.samples), 'run 2')],
    lambda a: [a, again(a, stamp_ns=a.samples.stamp_ns + 10**12)],
    lambda a: [a, again(a, xyz=a.samples.xyz.astype(np.float32).astype(float))],
], ids=['twice', 'contained', 'overlapping', 'other stamps', 'single precision'])  # fmt: skip
def test_samples_given_twice_are_refused(make):
    words = refused(*make(recorded()))
    assert words.startswith('run 2: ')
    assert 'run 1' in words


@pytest.mark.parametrize(('make', 'words'), [
    (lambda s: np.zeros_like(s) + s[0], 'equal'),
    (lambda s: s[np.arange(len(s)) // 30 * 30], 'about 30 samples'),
    (lambda s: s[0] + (s - s[0]) // 1000, r'faster'),
    (lambda s: s[0] + (s - s[0]) * 1000, 'never moves'),
    (lambda s: s[::-1].copy(), 'stamps go back'),
], ids=['equal', 'blocks', 'fast', 'slow', 'backward'])  # fmt: skip
def test_stamps_that_cannot_be_are_refused(make, words):
    a = recorded()
    assert words in refused(again(a, stamp_ns=make(a.samples.stamp_ns)))


@pytest.mark.parametrize('share', [1.0, 0.6])
@pytest.mark.parametrize('same_place', [True, False])
def test_two_streams_on_one_topic_are_named(share, same_place):
    a = recorded()
    turned = a.samples.xyz[:, [1, 2, 0]] + [1.0, 0.4, -0.3]
    words = refused(mixed(a, a if same_place else again(a, xyz=turned), share=share))
    assert 'two streams' in words or 'two trackers' in words


def test_the_path_of_another_machine_is_no_matter_of_tolerance():
    a = recorded()
    large = recorded(size=(0.6, 0.5, 0.4))
    scaled = NominalPath(large.path.points * 0.985)
    words = refused(replace(large, path=scaled))
    assert 'another program' in words and 'match_tolerance' not in words
    words = refused(with_axis(a, 'X', Axis(0.0, 0.2, 0.05)))
    assert 'axis X by 100.0 mm' in words


@pytest.mark.parametrize(('share', 'severity'), [(0.2, 'warning'), (0.5, 'gate')])
def test_outliers_are_told_from_noise(share, severity):
    (found,) = asked(spoiled_share(recorded(), share, 1e-3))
    assert (found.check, found.severity) == ('outliers', severity)
    said = float(found.words.split('about ')[1].split(' %')[0])
    assert said == pytest.approx(100 * share, abs=5)


@pytest.mark.parametrize('factor', [0.01, 100.0])
def test_a_specification_far_from_the_noise_is_said(factor):
    a = recorded()
    spec = TrackerSpec(factor * 0.5e-6, factor * 1.5e-6)
    (found,) = asked(with_machine(a, tracker=spec))
    assert (found.check, found.severity) == ('noise', 'warning')
    assert ('larger' in found.words) == (factor < 1)


def test_a_range_hardly_driven_is_said():
    (found,) = asked(with_axis(recorded(), 'Y', Axis(0.0, 2.5, 0.03)))
    assert (found.check, found.severity) == ('driven range', 'warning')
    assert '250 of 2500 mm' in found.words


@pytest.mark.parametrize('stated', ['w-b-Y-X-Z-t', 'w-Z-b-Y-X-t'])
def test_a_wrong_order_of_axes_is_a_gate_that_names_the_right_one(stated):
    (found,) = asked(with_machine(recorded(), chain=Chain.parse(stated)))
    assert (found.check, found.severity) == ('chain', 'gate')
    assert 'X Y Z (' in found.words and 'w-b-X-Y-Z-t' in found.words
    assert 'Z Y X (' not in found.words


def test_a_wrong_sign_of_a_target_offset_shows_between_runs_and_not_in_one():
    a = recorded(3)
    other = recorded(3, noise_seed=1, offset=(0.02, 0.0, -0.25))
    wrong = with_machine(other, target_offset=np.array([0.02, 0.0, 0.25]))
    assert asked(a, replace(other, name='run 2')) == ()
    (found,) = asked(a, replace(wrong, name='run 2'))
    assert (found.check, found.severity) == ('one machine', 'gate')
    assert 'target_offset' in found.words
    assert asked(wrong) == ()


def test_runs_of_different_machines_are_refused():
    a, b = recorded(), replace(recorded(noise_seed=1), name='run 2')
    other = replace(recorded(2), name='run 3')
    assert asked(a, b) == ()
    assert 'one machine' in refused(a, other)
    assert 'without run 3' in refused(a, b, other)


@pytest.mark.parametrize('size', [5e-6, 5e-4])
def test_a_tracker_that_moved_is_found_in_time(size):
    a = recorded(4)
    (found,) = asked(stepped(a, (0.6 * size, -0.8 * size, 0.0)))
    assert (found.check, found.severity) == ('moved', 'warning')
    seconds = float(found.words.split('moved ')[1].split(' s ')[0])
    assert seconds == pytest.approx(0.5 * a.samples.time[-1], abs=1.0)
    (plain,) = asked(stepped(a, (0.6 * size, -0.8 * size, 0.0)), repair=False)
    assert 'solved each' not in plain.words


def test_a_bed_that_warms_up_is_no_tracker_that_moved():
    """Its early growth explains itself as a step of tens of micrometres."""
    a = recorded(4)
    assert not [f for f in asked(warmed(a, 1e-4, early=0.05)) if f.check == 'moved']
    both = asked(stepped(warmed(a, 1e-4, early=0.05), (0.0, 3e-5, 0.0), at=0.6))
    (found,) = [f for f in both if f.check == 'moved']
    seconds = float(found.words.split('moved ')[1].split(' s ')[0])
    assert seconds == pytest.approx(0.6 * a.samples.time[-1], abs=1.0)


def test_a_drive_that_lags_is_no_tracker_that_moved():
    """Long lines come to their feed and short ones do not, so what it leaves comes and goes."""
    lagging = {'extra': Extra(lag=(0.0, 1e-4, 0.0)), 'path': 'default', 'size': (0.6, 0.5, 0.4)}
    a = recorded(5, chain='w-Y-b-X-Z-t', **lagging)
    assert not [f for f in asked(a) if f.check == 'moved']
    (found,) = [f for f in asked(stepped(a, (1.2e-5, -1.6e-5, 0.0))) if f.check == 'moved']
    seconds = float(found.words.split('moved ')[1].split(' s ')[0])
    assert seconds == pytest.approx(0.5 * a.samples.time[-1], abs=1.0)


def test_tables_are_right_though_the_tracker_moved():
    truth = cell(4)
    result = calibrate_recordings(
        [stepped(recorded(4), (3e-4, 4e-4, 0.0), turn=(0.0, 1e-3, 0.0))], CONFIG
    )
    left = judge(truth, result.tables)
    at_best = judge(truth, calibrate_recordings([recorded(4)], CONFIG).tables)
    assert left.left_percent < at_best.left_percent + 3
    assert any('moved' in w for w in result.warnings)
    assert result.failed_gates == ()


def test_a_tracker_that_moved_far_is_refused():
    words = refused(stepped(recorded(4), (0.03, 0.04, 0.0)))
    assert 'moved' in words
    assert float(words.split(' mm:')[0].split('by ')[1]) == pytest.approx(50, abs=1)


def test_a_beam_found_again_with_a_shift_is_corrected():
    shifted, plain = broken(recorded(5), 20, 20e-6), broken(recorded(5), 20, 0.0)
    assert asked(plain) == ()
    (found,) = asked(shifted)
    assert (found.check, found.severity) == ('found again', 'warning')
    left = judge(cell(5), calibrate_recordings([shifted], CONFIG).tables)
    at_best = judge(cell(5), calibrate_recordings([plain], CONFIG).tables)
    assert left.left_percent < at_best.left_percent + 5


MILD = Extra(drift=(6e-6, -4e-6, 7e-6), cyclic=(2e-6, 0.0, 0.0), lag=(2e-5, 0.0, 0.0))


@pytest.mark.parametrize('extra', [None, MILD], ids=['rigid', 'mild'])
@pytest.mark.parametrize(
    ('chain', 'form'),
    [('w-b-X-Y-Z-t', 'waves'), ('w-Y-b-X-Z-t', 'kinked'), ('w-X-Y-b-Z-t', 'waves')],
)
def test_nothing_is_claimed_of_healthy_runs(chain, form, extra):
    options = {'extra': extra} if extra else {}
    assert asked(recorded(7, chain=chain, form=form, **options)) == ()


def test_noise_that_wanders_is_no_step():
    slow = {'colour': 0.9, 'tau': 5.0}
    assert asked(replace(cell(8).recording(50.0, **slow), name='run 1')) == ()


def test_tables_as_uncertain_as_the_errors_fail():
    result = calibrate_recordings([recorded()], CONFIG)
    volume = VolumetricError(result.tables, result.covariance_run)
    error = np.sqrt(np.mean(volume.length**2))
    u = np.sqrt(np.median(volume.u_size**2))
    assert u < 0.2 * error
    assert check_worth(result.tables, result.covariance_run, 1e-6) == []
    scale = (1.1 * error / u) ** 2
    (gate,) = check_worth(result.tables, scale * result.covariance_run, 1e-6)
    (word,) = check_worth(result.tables, scale * result.covariance_run, error)
    assert (gate.severity, word.severity) == ('gate', 'warning')


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp('bag')
    a = recorded()
    stamp = a.samples.stamp_ns - a.samples.stamp_ns[0] + 1_700_000_000_000_000_000
    a = again(a, stamp_ns=stamp)
    write_bag(folder / 'bag', BagContent(a.samples, a.path))
    for name, chain in (('right', 'w-b-X-Y-Z-t'), ('wrong', 'w-b-Y-X-Z-t')):
        text = yaml.safe_dump(a.machine.to_dict() | {'chain': chain})
        (folder / f'{name}.yaml').write_text(text)
    return folder


def test_steps_of_one_run_are_told_by_its_own_clock():
    a = recorded(40, passes=2)
    twice = stepped(stepped(a, (15e-6, 0.0, 0.0), at=0.3), (-15e-6, 0.0, 5e-6), at=0.7)
    found = asked(twice)
    seconds = sorted(float(f.words.split('moved ')[1].split(' s ')[0]) for f in found)
    assert seconds == pytest.approx([0.3 * a.samples.time[-1], 0.7 * a.samples.time[-1]], abs=1)

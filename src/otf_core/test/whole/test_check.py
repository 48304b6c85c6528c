# SPDX-License-Identifier: Apache-2.0
"""The check of a recording against recordings that were spoilt on purpose."""

import numpy as np
import pytest
from bag_cells import PATH_MESSAGE, point_messages, write_mcap

from otf_core.bags.bag import BagContent, write_bag
from otf_core.checking.checks import check
from otf_core.model.observation import Samples


@pytest.fixture(scope='module')
def samples(cell):
    return cell.recording.measured(cell.truth)


@pytest.fixture
def checked(cell, tmp_path):
    """Check of given samples beside the path of the small cell, with its machine."""

    def of(samples, machine=cell.machine):
        write_bag(tmp_path / 'bag', BagContent(samples, cell.path))
        return check(str(tmp_path / 'bag'), machine)

    return of


def without(samples, dropped):
    return Samples(samples.stamp_ns[~dropped], samples.xyz[~dropped])


def named(report, severity):
    return [problem.check for problem in report.problems if problem.severity == severity]


def test_a_good_recording_is_usable_and_says_what_it_shows(cell, samples, calibrated, checked):
    report = checked(samples)
    facts = report.to_dict()
    assert report.usable and not named(report, 'error')
    assert facts['rate_hz'] == pytest.approx(100.0, rel=1e-3)
    assert facts['gaps'] == facts['without_beam'] == facts['legs_missing'] == 0
    assert facts['coverage'] == pytest.approx(calibrated.fit.coverage, abs=1e-6)
    assert set(facts['forecast']['not_identifiable']) == set(calibrated.not_identifiable)


def test_gaps_are_counted_and_placed(samples, checked):
    time = samples.time
    dropped = np.zeros(len(samples), bool)
    for start in (10.0, 25.0, 40.0):
        dropped |= (time > start) & (time < start + 1.5)
    report = checked(without(samples, dropped), None)
    facts = report.to_dict()
    assert facts['gaps'] == 3
    assert facts['longest_gap_s'] == pytest.approx(1.5, abs=0.03)
    assert facts['lost_share'] == pytest.approx(dropped.mean(), rel=0.02)
    (problem,) = report.checked['gaps'].problems
    assert all(f's at {at}' in problem.what for at in ('10.0', '25.0', '40.0'))


def test_points_in_the_origin_are_a_broken_beam(samples, tmp_path):
    xyz = samples.xyz.copy()
    xyz[2000:2050] = 0.0
    messages = point_messages(Samples(samples.stamp_ns, xyz).part(0, 4000))
    bag = write_mcap(tmp_path / 'run.mcap', [PATH_MESSAGE, *messages])
    facts = check(str(bag)).to_dict()
    assert facts['without_beam'] == 50 and facts['gaps'] == 1


def test_half_a_path_is_not_usable_and_the_missing_legs_are_named(cell, samples, checked):
    half = len(samples) // 2
    report = checked(samples.part(0, half))
    assert not report.usable and named(report, 'error') == ['path']
    facts = report.to_dict()
    assert 0.3 < facts['coverage'] < 0.7
    (problem,) = report.checked['path'].problems
    corners = 1e3 * cell.path.corners()[0]
    first = int(problem.what.split('missing legs: ')[1].split()[0]) - 1
    place = ', '.join(f'{v:.0f}' for v in corners[first] + 0.0)
    assert f'{first + 1} from ({place})' in problem.what
    legs = len(corners) - 1
    assert 0.3 * legs < facts['legs_missing'] < 0.7 * legs


def test_a_clock_that_was_set_is_told_from_a_gap(samples, tmp_path):
    part = samples.part(0, 4000)
    later = part.stamp_ns + np.where(np.arange(4000) < 2500, 0, 2_000_000_000)
    stamped = point_messages(Samples(later, part.xyz))
    messages = [
        (topic, kind, int(received), data)
        for (topic, kind, _, data), received in zip(stamped, part.stamp_ns, strict=True)
    ]
    report = check(str(write_mcap(tmp_path / 'set.mcap', [PATH_MESSAGE, *messages])))
    (problem,) = report.checked['clock'].problems
    assert f'first {part.time[2499]:.1f} s' in problem.what
    report = check(str(write_mcap(tmp_path / 'gap.mcap', [PATH_MESSAGE, *stamped])))
    assert not report.checked['clock'].problems and report.to_dict()['gaps'] == 1

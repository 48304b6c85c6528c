# SPDX-License-Identifier: Apache-2.0
"""The end of a run: what is found of the track before it is known changes nothing later."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import record, small_plan, some_machine
from rotary_cells import machine as rotary_machine

from otf_core.config import CalibrationConfig
from otf_core.model.axis_path import AxisPath, nominal_track
from otf_core.model.observation import Samples
from otf_core.tracking import arc_length, path_watch
from otf_core.tracking.alignment import align, follow_track
from otf_core.tracking.path_watch import PathWatcher

CONFIG = CalibrationConfig()
MACHINE = some_machine()
RECORDING = record(MACHINE, small_plan(MACHINE))


def standing(samples, seconds):
    """A run whose target stands at its end for longer, by the noise of its last samples."""
    step = int(samples.step_ns)
    count = round(seconds / samples.step)
    noise = np.random.default_rng(8).normal(scale=2e-6, size=(count, 3))
    stamps = samples.stamp_ns[-1] + step * np.arange(1, count + 1)
    xyz = np.concatenate([samples.xyz, samples.xyz[-1] + noise])
    return Samples(np.concatenate([samples.stamp_ns, stamps]), xyz)


def test_what_was_seen_of_a_run_before_its_last_samples_changes_nothing():
    path, early = RECORDING.path, RECORDING.measured(seed=3)
    late = standing(early, 1.0)
    seen = follow_track(early, path, CONFIG)
    assert seen.to_the_end and follow_track(late, path, CONFIG, seen) is seen
    plain, found = (align(late, path, CONFIG, known) for known in (None, seen))
    for name in ('rotation', 'translation'):
        one, other = (getattr(a.T_machine_tracker, name) for a in (plain, found))
        assert one.tobytes() == other.tobytes()
    assert found.leg.tobytes() == plain.leg.tobytes() and found.coverage == plain.coverage
    other = replace(CONFIG, corner_exclusion=0.01)
    assert follow_track(early, path, other, seen).config == other
    again = follow_track(early.part(0, len(early) // 2), path, CONFIG, seen)
    assert again is not seen and not again.to_the_end


def watched(samples):
    """Standstills, s, after which a watcher wants a run looked at, and ends it."""
    watcher, asked, ended = PathWatcher(RECORDING.path, CONFIG), [], {}
    for stamp, point in zip(samples.stamp_ns.tolist(), samples.xyz.tolist(), strict=True):
        watcher.add(stamp, *point)
        if watcher.worth_judging:
            asked.append(watcher.standstill)
            watcher.judge()
        if watcher.stood:
            ended.setdefault(watcher.end, watcher.standstill)
    return asked, list(ended.values())


def test_standstill_after_the_whole_path_is_looked_at_soon_and_ends_a_run_soon():
    asked, ended = watched(standing(RECORDING.measured(seed=3), 1.5))
    assert len(ended) == 1 and 0.05 <= asked[-1] < 0.1 and 0.25 <= ended[0] < 0.35


def test_samples_of_a_run_do_not_depend_on_when_it_is_looked_at():
    samples = standing(RECORDING.measured(seed=3), 1.5)
    late = [PathWatcher(RECORDING.path, CONFIG) for _ in range(2)]
    soon, ends = PathWatcher(RECORDING.path, CONFIG), []
    for stamp, (x, y, z) in zip(samples.stamp_ns.tolist(), samples.xyz.tolist(), strict=True):
        for watcher in (soon, *late):
            watcher.add(stamp, x, y, z)
        if soon.worth_judging:
            soon.judge()
            ends.append(soon.end)
    assert ends[-1] < len(samples) - 1.0 / samples.step
    assert np.linalg.norm(samples.xyz[ends[-1] - 1] - samples.xyz[-1]) < 1e-3
    for k in range(1, 200):  # it moves on before anybody looks
        late[1].add(stamp + k * int(samples.step_ns), x + 0.01 * k, y, z)
    for watcher in late:
        assert watcher.worth_judging and watcher.stood and watcher.end == ends[-1]
        watcher.dismiss()
        assert watcher.end is None and not watcher.worth_judging and not watcher.stood


def test_standstill_on_the_way_is_looked_at_later():
    samples = RECORDING.measured(seed=3)
    way = np.linalg.norm(np.diff(samples.xyz, axis=0), axis=1).cumsum()
    early = samples.part(0, int(np.searchsorted(way, 0.8 * RECORDING.path.length)))
    assert watched(early) == ([], [])
    asked, ended = watched(standing(early, 1.5))
    assert len(asked) == len(ended) == 1 and asked[0] == ended[0] >= 1.0


@pytest.mark.parametrize('seconds', [0.2, 0.3])
def test_who_moves_on_has_stood_if_it_was_for_long_enough(seconds):
    samples, watcher = RECORDING.measured(seed=3), PathWatcher(RECORDING.path, CONFIG)
    rows = zip(samples.stamp_ns.tolist(), samples.xyz.tolist(), strict=True)
    while watcher.travelled < 0.99 * RECORDING.path.length or watcher.standstill < seconds:
        stamp, (x, y, z) = next(rows)
        watcher.add(stamp, x, y, z)
    assert watcher.worth_judging
    watcher.judge()
    watcher.add(stamp + int(samples.step_ns), x + 0.01, y, z)
    assert watcher.stood == (seconds > 0.25) and (watcher.end is None) == (seconds < 0.25)


def test_samples_out_of_order_are_looked_at_by_stamp_and_no_travel_to_and_fro():
    samples, watcher = RECORDING.measured(seed=3), PathWatcher(RECORDING.path, CONFIG)
    late = np.random.default_rng(2).uniform(0.0, 1e8, len(samples))
    order = np.argsort(samples.stamp_ns + late)
    for i in order.tolist():
        watcher.add(int(samples.stamp_ns[i]), *samples.xyz[i].tolist())
    assert watcher.look(Samples(samples.stamp_ns[order], samples.xyz[order])).to_the_end
    assert 0.97 < watcher.travelled / RECORDING.path.length < 1.03


def test_work_of_looking_at_parts_is_that_of_the_new_samples(monkeypatch):
    machine, rng = rotary_machine(), np.random.default_rng(12)
    q = np.zeros((30, len(machine.axis_names)))
    for k, name in enumerate('XYZ'):
        q[:, k] = rng.uniform(machine.axes[name].min, machine.axes[name].max, len(q))
    path = nominal_track(machine, [AxisPath(machine.axis_names, q)])
    way = np.append(0.0, np.cumsum(path.leg_lengths))
    reach = np.linspace(0.0, way[-1], 300_000)
    xyz = np.stack([np.interp(reach, way, own) for own in path.points.T], axis=1)
    noisy = xyz + 2e-6 * rng.normal(size=xyz.shape)
    samples = Samples(np.arange(len(xyz)) * 2_000_000, noisy)

    watcher, visited, compared = PathWatcher(path, CONFIG), [], []
    moved, match = arc_length._moved, path_watch.match
    monkeypatch.setattr(
        arc_length, '_moved', lambda p, last: visited.append(len(p)) or moved(p, last)
    )
    monkeypatch.setattr(
        path_watch, 'match', lambda *a, **k: compared.append(len(a[0])) or match(*a, **k)
    )
    ends = [watcher.look(samples.part(0, k)) for k in range(250, len(xyz) + 1, 250)]
    at_the_end = [k for k, seen in enumerate(ends) if seen.to_the_end]
    assert at_the_end[-1] == len(ends) - 1 and at_the_end[0] > 0.98 * len(ends)
    assert len(compared) <= 2  # each visits all samples twice: to split and to follow
    assert sum(visited) <= (1 + 2 * len(compared)) * len(xyz) / 10


def test_parts_shorter_than_the_moves_by_hand_between_them_are_counted():
    machine = rotary_machine()
    corners = np.zeros((2, len(machine.axis_names)))
    corners[:, 0] = machine.axes['X'].min + np.array([0.0, 0.05])
    apart = np.eye(len(machine.axis_names))[0] * 0.2
    both = (corners, corners + apart)
    both[1][1, machine.column('C')] = 1.0  # takes much longer than its line
    path = nominal_track(machine, [AxisPath(machine.axis_names, q) for q in both])
    assert path.part_lengths == pytest.approx([0.05, 0.05])
    watcher = PathWatcher(path, CONFIG)
    for number in (0, 1):
        first, end = (0, *path.ends)[number], path.ends[number]
        a, b = path.points[first], path.points[end - 1]
        for k, share in enumerate(np.linspace(0.0, 1.0, 100)):
            stamp = number * 5_000_000_000 + k * 10_000_000
            watcher.add(stamp, *(a + share * (b - a)).tolist())
        assert watcher.part == number + 1
        assert watcher.time_share == pytest.approx((0.05, 1.0)[number], abs=0.01)

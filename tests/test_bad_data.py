# SPDX-License-Identifier: Apache-2.0
"""Bad data, live and offline: the same samples or the same refusal, and the cause in words.

The live side is the intake of the calibrator, which journals what it is given; the offline side
reads that journal. What happens to samples after that is the same code with the same samples.
"""

import re
import time
from pathlib import Path

import numpy as np
import pytest

from otf_calibrator.params import CalibratorConfig
from otf_calibrator.run import SILENT
from otf_calibrator.session import Session
from otf_calibrator.worker import recording_of
from otf_core.bags.bag import read_bag
from otf_core.bags.cdr import encode_path
from otf_core.bags.journal import Journal
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.inputs.recordings import read_content
from otf_core.model.path import NominalPath

ROOT = Path(__file__).parents[1]
CELL = ROOT / 'bags' / 'y-carries-the-table'
WHOLE = read_bag(CELL / 'bag')
STAMP, XYZ = WHOLE.samples.stamp_ns[::8], WHOLE.samples.xyz[::8]
COUNT = len(STAMP)
SETTINGS = CalibratorConfig(machine_file=str(CELL / 'machine.yaml'))
BATCH = 500


def instead(share, value):
    """Some points are not what they should be."""
    xyz, chosen = XYZ.copy(), np.random.default_rng(5).random(COUNT) < share
    chosen[0] = False
    xyz[chosen] = value
    return STAMP, xyz, None


def shuffled():
    order = np.arange(COUNT).reshape(-1, 5)[:, ::-1].ravel() if COUNT % 5 == 0 else None
    order = np.arange(COUNT) if order is None else order
    order[100:110] = order[100:110][::-1]
    return STAMP[order], XYZ[order], None


def repeated():
    order = np.sort(np.concatenate([np.arange(COUNT), np.arange(0, COUNT, 7)]))
    return STAMP[order], XYZ[order], None


def off(count):
    """Some samples have stamps that are off."""
    stamp, wrong = STAMP.copy(), [0, -5 * 10**9, STAMP[-1] + 3600 * 10**9, (2**31 - 1) * 10**9]
    stamp[np.linspace(600, COUNT - 600, count).astype(int)] = np.resize(wrong, count)
    return stamp, XYZ, None


def foreign(share):
    frames = np.where(np.random.default_rng(6).random(COUNT) < share, 'lab', 'tracker')
    return STAMP, XYZ, frames


def two_trackers(apart_ns):
    turned = XYZ @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]).T + 0.5
    stamp = np.stack([STAMP, STAMP + apart_ns], 1).ravel()
    return stamp, np.stack([XYZ, turned], 1).reshape(-1, 3), None


def moved(size):
    xyz = XYZ.copy()
    xyz[COUNT // 2 :] += [size, 0.0, 0.0]
    return STAMP, xyz, None


def outliers(size):
    xyz, rng = XYZ.copy(), np.random.default_rng(7)
    xyz += rng.choice([-size, 0.0, 0.0, size], (COUNT, 1))
    return STAMP, xyz, None


REPAIRED = {
    'NaN': (lambda: instead(0.4, np.nan), 'points that are not finite'),
    'infinite': (lambda: instead(0.01, -np.inf), 'points that are not finite'),
    'zero points': (lambda: instead(0.4, 0.0), 'in the origin of the tracker (no beam)'),
    'points out of reach': (lambda: instead(0.005, 2e4), 'points beyond 1000 m'),
    'out of order': (shuffled, 'stamps went back'),
    'single wrong stamps': (lambda: off(6), 'points whose stamps are off by more than 1 s'),
    'repeated samples': (repeated, 'repeated samples and 0 with the stamp of another point'),
    'points in another frame': (lambda: foreign(0.3), "frame_id is 'lab', expected 'tracker'"),
}
REFUSED = {
    'NaN, most': (lambda: instead(0.6, np.nan), 'not finite; do not publish points without'),
    'zero points, most': (lambda: instead(0.6, 0.0), 'beam had been broken most of the time'),
    'points out of reach, many': (lambda: instead(0.05, 2e4), 'the unit is m'),
    'points in another frame, most': (lambda: foreign(0.9), "frame_id is 'lab'"),
    'wrong stamps, many': (lambda: off(COUNT // 20), 'the clock was set back or several runs'),
    'no stamps': (lambda: (0 * STAMP, XYZ, None), 'header.stamp is not set'),
    'two trackers, one clock': (lambda: two_trackers(0), 'two trackers publish on one topic'),
    'two trackers, clocks apart': (lambda: two_trackers(10**12), 'trackers are mixed'),
}
UNFIT = {  # without words: the core's own tests look for them
    'millimetres': (lambda: (STAMP, 500 * XYZ, None), 'seem to be in mm'),
    'left-handed': (lambda: (STAMP, XYZ * [-1.0, 1, 1], None), None),
    'half of the points off by metres': (lambda: outliers(1.0), 'outliers; look for reflections'),
    'two trackers, places apart': (lambda: two_trackers(3_000_000), 'two streams'),
    'tracker moved far': (lambda: moved(0.05), None),
}


class Side:
    """A calibrator without a graph."""

    def __init__(self, folder):
        self.said = []
        self.session = Session(lambda: (SETTINGS, CalibrationConfig()), self.said.append)
        self.session.intake.journal = Journal(folder, {})
        self.path(WHOLE.path)

    def path(self, path):
        message = encode_path(path.points, 0, 'machine')
        self.session.intake.take_path(path, message)

    def take(self, stamp, xyz, frames):
        """Give samples as they arrive, some at a time."""
        for at in range(0, len(stamp), BATCH):
            rows = slice(at, at + BATCH)
            names = np.full(len(stamp), 'tracker') if frames is None else frames
            points = {
                str(name): (stamp[rows][names[rows] == name], xyz[rows][names[rows] == name])
                for name in np.unique(names[rows])
            }
            self.session.intake.take_samples(points)
        time.sleep(1.1 * SILENT * bool(self.session.collector.held))
        self.session.intake.decide()

    def close(self):
        """Return the folders of the runs."""
        journal = self.session.intake.journal
        self.session.close()
        return sorted(p for p in journal.directory.iterdir() if p.is_dir())


@pytest.fixture
def side(tmp_path):
    return Side(tmp_path / 'journal')


def outcome(read):
    """Samples and what is said of them, or why they are refused."""
    try:
        found = read()
    except InputError as error:
        return str(error).partition(': ')[2].partition('tracker/point: ')[2] or str(error)
    return found.samples.stamp_ns.tobytes(), found.samples.xyz.tobytes(), found.remarks


def both_sides(side, data, publishers=1):
    side.session.collector.publishers = publishers
    side.take(*data)
    request = side.session.request()
    live = outcome(lambda: recording_of(request))
    (folder,) = side.close()
    offline = outcome(lambda: read_bag(folder))
    return live, offline, folder


@pytest.mark.parametrize('name', REPAIRED)
def test_what_is_bad_here_and_there_is_left_out_and_said(side, name):
    make, words = REPAIRED[name]
    live, offline, _ = both_sides(side, make())
    assert live[:2] == offline[:2]
    stamp, xyz, frames = make()
    good = np.isfinite(xyz).all(axis=1) & (np.abs(xyz).max(axis=1) < 1e3) & xyz.any(axis=1)
    good &= np.abs(stamp - STAMP[0]) < 10**12
    good &= True if frames is None else frames == 'tracker'
    kept, at = np.unique(stamp[good], return_index=True)
    assert live[0] == kept.tobytes() and live[1] == xyz[good][at].tobytes()
    for said in (live[2], offline[2]):
        assert len(said) == 1 and words in said[0], said


@pytest.mark.parametrize('name', REFUSED)
def test_what_is_bad_as_a_whole_is_refused_with_its_cause(side, name):
    make, words = REFUSED[name]
    live, offline, _ = both_sides(side, make(), publishers=1 + name.startswith('two'))
    assert isinstance(live, str) and words in live, live
    assert isinstance(offline, str) and words in offline, offline


@pytest.mark.parametrize('name', UNFIT)
def test_what_does_not_fit_the_path_is_refused_with_its_cause(side, name):
    make, words = UNFIT[name]
    live, offline, _ = both_sides(side, make(), publishers=1 + name.startswith('two'))
    assert live == offline
    recording = recording_of(side.session.request())
    if words is None:
        return
    with pytest.raises(InputError, match=re.escape(words)):
        calibrate_recordings([recording])


def test_path_of_another_machine_is_refused_with_its_cause(side):
    side.path(NominalPath(WHOLE.path.points * [1.0, 1.3, 0.8]))
    side.take(STAMP, XYZ, None)
    with pytest.raises(InputError, match='do bag and machine description belong together'):
        calibrate_recordings([recording_of(side.session.request())])
    side.close()


def test_clock_set_back_begins_a_run_live_and_the_parts_stay_apart(side):
    half, back = COUNT // 2, 5 * 10**9
    stamp = np.concatenate([STAMP[:half], STAMP[half:] - back])
    side.take(stamp, XYZ, None)
    assert 'went back' in side.said[0] and str(half) in side.said[0]
    recording = recording_of(side.session.request())
    assert recording.samples.xyz.tobytes() == XYZ[half:].tobytes()
    assert f'{half} samples before this run were set aside' in recording.remarks[0]
    folders = side.close()
    parts = [read_bag(folder).samples for folder in folders]
    assert [len(p) for p in parts] == [half, COUNT - half]
    with pytest.raises(InputError, match='the clock was set back'):
        read_content(folders)


def other_path():
    """A path through the same volume that is not the one driven."""
    return NominalPath(WHOLE.path.points[:, [0, 2, 1]] * [1.0, 1.2, -0.8])


def test_another_path_in_mid_run_costs_nothing_and_is_that_of_the_next_run(side):
    side.take(STAMP[:2000], XYZ[:2000], None)
    side.path(other_path())
    side.take(STAMP[2000:], XYZ[2000:], None)
    request = side.session.request()
    assert np.array_equal(request.path.points, WHOLE.path.points)
    assert len(request.samples) == COUNT and not side.said
    side.session.forget()
    assert np.array_equal(side.session.collector.path.points, other_path().points)
    side.take(STAMP[:100] + 10**12, XYZ[:100], None)
    first, second = side.close()
    assert len(read_bag(first).samples) == COUNT
    assert np.array_equal(read_bag(first).path.points, WHOLE.path.points)
    assert np.array_equal(read_bag(second).path.points, other_path().points)

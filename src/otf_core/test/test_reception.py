# SPDX-License-Identifier: Apache-2.0
"""Order of reception against order of stamps, and one of several publishers on a topic."""

import numpy as np
import pytest
from bag_cells import CORNERS, PATH_MESSAGE, START, point_messages, write_mcap
from cli_cells import run

from otf_core.bags.bag import read_bag
from otf_core.bags.sample_order import sort_by_time
from otf_core.errors import ConfigError, InputError
from otf_core.inputs.recordings import ReadingOptions, read_content
from otf_core.model.observation import Samples

COUNT, STEP = 2000, 10_000_000
STAMPS = START + STEP * np.arange(COUNT)
S = 1_000_000_000


def track(count=COUNT, seed=1, place=(1.5, -2.0, 0.5)):
    """A target that goes forth and back at 0.2 m/s, 100 Hz, with the noise of a tracker."""
    way = 0.002 * np.arange(count)
    along = np.abs((way + 0.1) % 1.2 - 0.6)
    xyz = np.stack([along, 0.3 * along, 0.1 * np.floor(way / 1.2)], axis=1) + place
    return xyz + np.random.default_rng(seed).normal(0, 2e-6, xyz.shape)


XYZ = track()


def ordered(stamps, xyz=XYZ):
    remarks = []
    samples = sort_by_time('run', np.asarray(stamps, np.int64), xyz, remarks)
    return samples, remarks


# ---------------------------------------------------------------- clocks that go back


@pytest.mark.parametrize('back', [5 * S, 3600 * S, (1 << 32) * 1_000_000])
def test_a_clock_that_goes_back_is_refused_with_its_place(back):
    stamps = np.concatenate([STAMPS[:900], STAMPS[900:] - back])
    with pytest.raises(
        InputError, match=rf'goes back by {back / S - 0.01:.3f} s at sample 900; the clock'
    ):
        ordered(stamps)


@pytest.mark.parametrize('wrong', [0, 2**31 * S, START - 5 * S])
@pytest.mark.parametrize('count', [1, 3])
def test_single_wrong_stamps_are_no_seams(wrong, count):
    stamps = STAMPS.copy()
    stamps[700 : 700 + count] = wrong
    samples, remarks = ordered(stamps)
    np.testing.assert_array_equal(samples.stamp_ns, np.delete(STAMPS, range(700, 700 + count)))
    assert f'dropped {count} of {COUNT} points whose stamps are off' in remarks[0]


def test_two_runs_after_each_other_are_not_joined():
    stamps = np.concatenate([STAMPS[:900] + 100 * S, STAMPS[:1100]])
    xyz = np.concatenate([XYZ[:900], XYZ[:1100] + np.array([0.0, 0.4, 0.0])])
    with pytest.raises(InputError, match=r'goes back by .* s at sample 900'):
        ordered(stamps, xyz)


# ---------------------------------------------------------------- sorted to and fro


def lost_zeros(stamps):
    return [int(f'{t // S}{str(t % S).ljust(9, "0")}') for t in stamps.tolist()]


def test_stamps_joined_without_leading_zeros_are_refused():
    with pytest.raises(InputError, match='back and forth when sorted by stamp'):
        ordered(lost_zeros(STAMPS + 123_456))


@pytest.mark.parametrize('reach', [2, 20, 90])
def test_samples_that_transport_has_shuffled_are_sorted(reach):
    order = np.argsort(np.arange(COUNT) + np.random.default_rng(3).uniform(0, reach, COUNT))
    samples, remarks = ordered(STAMPS[order], XYZ[order])
    assert samples.xyz.tobytes() == XYZ.tobytes()
    assert 'sorted by stamp' in remarks[0]


def test_shuffled_at_a_standstill_are_sorted():
    xyz = np.tile(XYZ[0], (COUNT, 1)) + np.random.default_rng(4).normal(0, 2e-6, XYZ.shape)
    order = np.argsort(np.arange(COUNT) + np.random.default_rng(5).uniform(0, 20, COUNT))
    samples, _ = ordered(STAMPS[order], xyz[order])
    assert samples.xyz.tobytes() == xyz.tobytes()


# ---------------------------------------------------------------- publishers

OTHER = track(seed=2, place=(-1.0, 3.0, 0.2))


def mixed(apart_ns, gap=0):
    """Samples of two publishers side by side, the second from sample ``gap`` on."""
    rows = [(k, 0, t, p) for k, (t, p) in enumerate(zip(STAMPS.tolist(), XYZ, strict=True))]
    rows += [
        (k + 0.5, 1, t + apart_ns, p)
        for k, (t, p) in enumerate(zip(STAMPS.tolist(), OTHER, strict=True))
        if k >= gap
    ]
    return sorted(rows, key=lambda row: row[:2])


def bag_of(tmp_path, rows, channels=False):
    messages = [PATH_MESSAGE]
    for at, who, stamp, point in rows:
        (one,) = point_messages(Samples(np.array([stamp]), np.array([point])))
        name = '/tracker/point#2' if channels and who else one[0]
        messages.append((name, one[1], START + int(1000 * at), one[3]))
    return write_mcap(tmp_path / 'run.mcap', messages)


@pytest.mark.parametrize('apart', [-49 * S, 10 * S, 10**15])
@pytest.mark.parametrize('gap', [0, 700])
def test_one_of_two_clocks_is_taken_as_the_message_says(tmp_path, apart, gap, capsys):
    file = bag_of(tmp_path, mixed(apart, gap))
    with pytest.raises(InputError) as refused:
        read_bag(file)
    said = str(refused.value)
    assert f'publisher: 1 ({COUNT} samples' in said
    assert f'publisher: 2 ({COUNT - gap} samples' in said
    first, second = (read_content([file], ReadingOptions(publisher=k)) for k in (1, 2))
    assert first.samples.xyz.tobytes() == XYZ.tobytes()
    assert second.samples.xyz.tobytes() == OTHER[gap:].tobytes()
    assert first.remarks[0].startswith(
        '2 publishers on /tracker/point, distinguished by their clocks'
    )
    run('check', file)
    assert 'publisher: 2' in ''.join(capsys.readouterr())
    run('check', file, {'publisher': 1})
    assert f'using 1: {COUNT} samples' in ''.join(capsys.readouterr())


def test_a_pause_of_one_clock_is_no_further_publisher(tmp_path):
    rows = [row for row in mixed(-49 * S) if row[1] or not 400 < row[0] < 900]
    file = bag_of(tmp_path, rows)
    content = read_content([file], ReadingOptions(publisher=1))
    keep = np.r_[0:401, 900:COUNT]
    assert content.samples.xyz.tobytes() == XYZ[keep].tobytes()


def test_channels_tell_publishers_apart_on_one_clock(tmp_path):
    file = bag_of(tmp_path, mixed(STEP // 2), channels=True)
    content = read_content([file], ReadingOptions(publisher=2))
    assert content.samples.xyz.tobytes() == OTHER.tobytes()
    assert 'distinguished by their channels' in content.remarks[0]


def test_places_tell_publishers_apart_on_one_clock(tmp_path):
    file = bag_of(tmp_path, mixed(STEP // 2))
    content = read_content([file], ReadingOptions(publisher=2))
    assert content.samples.xyz.tobytes() == OTHER.tobytes()
    assert 'the places of their targets' in content.remarks[0]


def test_a_publisher_that_there_is_not_is_refused_with_those_there_are(tmp_path):
    file = bag_of(tmp_path, mixed(10 * S))
    with pytest.raises(ConfigError, match=r'publisher: 3: .* publisher: 1 \(2000 .* publisher: 2'):
        read_content([file], ReadingOptions(publisher=3))
    alone = bag_of(tmp_path, mixed(0, COUNT))
    with pytest.raises(ConfigError, match='has one publisher'):
        read_content([alone], ReadingOptions(publisher=1))


def test_one_of_two_clocks_in_a_text(tmp_path):
    rows = mixed(-49 * S)
    lines = [f'{t},{p[0]!r},{p[1]!r},{p[2]!r}' for _, _, t, p in
             ((a, b, c, d.tolist()) for a, b, c, d in rows)]  # fmt: skip
    (tmp_path / 'run.csv').write_text('\n'.join(['time_ns,x_m,y_m,z_m', *lines, '']))
    (tmp_path / 'path.csv').write_text(
        'x,y,z\n' + '\n'.join(','.join(map(str, p)) for p in CORNERS)
    )
    given = ReadingOptions(path=tmp_path / 'path.csv', publisher=1)
    content = read_content([tmp_path / 'run.csv'], given)
    assert content.samples.xyz.tobytes() == XYZ.tobytes()

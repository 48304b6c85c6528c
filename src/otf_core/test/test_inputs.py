# SPDX-License-Identifier: Apache-2.0
"""Recordings as people have them: texts of many forms, other topics and types, paths beside."""

import json
import os

import numpy as np
import pytest
from bag_cells import (
    CONTENT,
    CORNERS,
    PATH_TYPE,
    START,
    STORE,
    header,
    path_cdr,
    point_messages,
    write_mcap,
)
from cli_cells import run, write_points

from otf_core.bags.bag import points_of
from otf_core.errors import ConfigError, InputError
from otf_core.inputs.path_file import read_path, read_points
from otf_core.inputs.recordings import ReadingOptions, open_reading, read_content
from otf_core.inputs.text_points import TextReading

STAMPS = START + 2_000_000 * np.arange(50)
XYZ = np.random.default_rng(5).normal([1.5, -2.0, 0.5], size=(50, 3)).round(7)
SECONDS = [f'{t // 10**9}.{t % 10**9:09d}' for t in STAMPS.tolist()]
SINCE = STAMPS - STAMPS[0]


def lines(form, head='', tail=''):
    """A text of the samples; ``form`` takes stamp text, ns since start, x, y, z in m."""
    rows = zip(SECONDS, SINCE.tolist(), XYZ.tolist(), strict=True)
    return head + '\n'.join(form(s, t, *p) for s, t, p in rows) + '\n' + tail


def mm(*values):
    return [f'{1e3 * v:.4f}' for v in values]


PLAIN = lines(lambda s, t, *p: ','.join([s, *map(repr, p)]), 'time_s,x_m,y_m,z_m\n')


def reading(tmp_path, text, **options):
    (tmp_path / 'run.csv').write_text(text, encoding='utf-8')
    return TextReading(tmp_path / 'run.csv', **options)


def test_columns_and_rate_on_request(tmp_path):
    text = lines(lambda s, t, *p: ' '.join([s, s.split('.')[0], str(t // 1000), *mm(*p)]))
    with pytest.raises(InputError, match=r'6 columns.*--columns'):
        reading(tmp_path, text)
    raw = reading(tmp_path, text, columns='-,-,time_us,x_mm,y_mm,z_mm').received()
    np.testing.assert_allclose(raw.xyz, XYZ, atol=6e-8)
    np.testing.assert_array_equal(raw.stamp_ns, SINCE)
    text = lines(lambda s, t, *p: ' '.join(mm(*p)))
    with pytest.raises(InputError, match='times'):
        reading(tmp_path, text)
    np.testing.assert_array_equal(reading(tmp_path, text, rate=500.0).received().stamp_ns, SINCE)
    for columns, words in (
        ('a,b,c', "'a' is unknown"),
        ('x,y', 'does not name'),
        ('-,' * 9, '10'),
    ):
        with pytest.raises(ConfigError, match=words):
            reading(tmp_path, text, columns=columns, rate=1.0)
    with pytest.raises(ConfigError, match=r'--rate: .*time_s'):
        reading(tmp_path, PLAIN, rate=500.0)
    raw = reading(tmp_path, PLAIN, columns='-,x,y,z', rate=500.0).received()
    np.testing.assert_array_equal(raw.stamp_ns, SINCE)


def test_a_text_is_a_recording_with_a_path_beside_it(tmp_path, capsys):
    file, corners = tmp_path / 'run.txt', tmp_path / 'path.csv'
    file.write_text(PLAIN)
    with pytest.raises(InputError, match='path'):
        read_content([file])
    write_points(corners, CORNERS)
    content = read_content([file], ReadingOptions(path=corners))
    np.testing.assert_array_equal(content.path.points, CORNERS)
    np.testing.assert_array_equal(content.samples.xyz, XYZ)
    assert run('check', file, '--path', corners, '--json') == 3  # these samples follow no path
    shown = capsys.readouterr()
    assert (
        json.loads(shown.out)['samples'] == 50 and 'x, y, z from x_m, y_m, z_m in m' in shown.err
    )
    with pytest.raises(ConfigError, match='topic'):
        read_content([file], ReadingOptions(path=corners, topic='/point'))
    assert run('check', file, '--rate', '-5') == 2


def test_paths_are_plans_or_corner_points_in_m_or_mm(tmp_path):
    part = {'target': 'tool', 'feed': [0.1] * 3, 'dwell': [0] * 4, 'positions': CORNERS.tolist()}
    assumed = {'tracker_link': 'w', 'tracker_place': [0, 0, 0]}
    plan = {'schema': 'otf-plan/2', 'axes': list('XYZ'), 'parts': [part], 'assumed': assumed}
    (tmp_path / 'plan.json').write_text(json.dumps(plan))
    np.testing.assert_array_equal(read_path(tmp_path / 'plan.json')[0], CORNERS)
    rows = '\n'.join(';'.join(mm(*p)) for p in CORNERS.tolist())
    (tmp_path / 'path.csv').write_text(f'X [mm];Y [mm];Z [mm]\n{rows}\n')
    np.testing.assert_allclose(read_path(tmp_path / 'path.csv')[0], CORNERS, atol=1e-12)


@pytest.mark.parametrize(
    'text',
    [
        'X;Y;Z\n0,1;-0,2;0\n0,3;0,2;-0,1\n',
        'No\tX (mm)\tY (mm)\tZ (mm)\n1\t100\t-200\t0\n2\t300\t200\t-100\n',
        '0.1 -0.2 0\n0.3 0.2 -0.1\n',
        'x;y;z\nmm;mm;mm\n100;-200;0\n300;200;-100\n',
        '\ufeffx_mm,y_mm,z_mm\r\n100,-200,0\r\n300,200,-100\r\n',
        'y,remark,x,z\n-0.2,a,0.1,0\n0.2,b,0.3,-0.1\n',
    ],
)
def test_points_are_read_as_people_have_them(tmp_path, text):
    (tmp_path / 'points.csv').write_text(text, encoding='utf-8')
    points, said = read_points(tmp_path / 'points.csv')
    np.testing.assert_allclose(points, [[0.1, -0.2, 0.0], [0.3, 0.2, -0.1]], atol=1e-15)
    assert ('in mm' in said) == ('mm' in text)


@pytest.mark.parametrize(
    ('text', 'what'),
    [
        ('X;Y;Z\n1;2;3\n1;2;a\n4;5;6\n' + '1;1;1\n' * 20, 'line 3: expected numbers'),
        ('X [mm];Y [m];Z [mm]\n1;2;3\n', 'x, y, z are in'),
        ('x [ft],y [ft],z [ft]\n1,2,3\n', "'ft'"),
        ('X;Y;Z\n1;nan;3\n', 'line 2: not finite'),
        ('X;Y;Z\n1;2;3\n1;10:11:12;3\n', r"Y is '10:11:12' \(line 3\)"),
        ('G1 X0 Y0\n', 'expected the header x,y,z'),
        ('a,b,c\n1,2,3\n', r'a,b,c'),
    ],
)
def test_points_that_are_none_are_refused_with_their_line(tmp_path, text, what):
    (tmp_path / 'points.csv').write_text(text, encoding='utf-8')
    with pytest.raises(ConfigError, match=what):
        read_points(tmp_path / 'points.csv')


@pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='no named pipes')
@pytest.mark.parametrize('reader', [read_points, read_path])
def test_points_in_a_pipe_are_refused_before_any_is_lost(tmp_path, reader):
    os.mkfifo(tmp_path / 'points.csv')
    with pytest.raises(ConfigError, match=r'pipe'):
        reader(tmp_path / 'points.csv')


def stamped(kind, stamp, xyz, frame, child='target'):
    """A message that holds a point, as the reference library encodes it."""
    kinds = STORE.types
    x, y, z = map(float, xyz)
    point, turn = (
        kinds['geometry_msgs/msg/Point'](x, y, z),
        kinds['geometry_msgs/msg/Quaternion'](0.5, 0.5, 0.5, 0.5),
    )
    pose = kinds['geometry_msgs/msg/Pose'](point, turn)
    at, covariance = header(stamp, frame), np.zeros(36)
    vector = kinds['geometry_msgs/msg/Vector3']
    twist = kinds['geometry_msgs/msg/TwistWithCovariance'](
        kinds['geometry_msgs/msg/Twist'](vector(1.0, 2.0, 3.0), vector(4.0, 5.0, 6.0)), covariance
    )
    with_covariance = kinds['geometry_msgs/msg/PoseWithCovariance'](pose, covariance)
    content = {
        'geometry_msgs/msg/PoseStamped': (at, pose),
        'geometry_msgs/msg/PoseWithCovarianceStamped': (at, with_covariance),
        'geometry_msgs/msg/TransformStamped': (
            at, child, kinds['geometry_msgs/msg/Transform'](vector(x, y, z), turn)
        ),
        'nav_msgs/msg/Odometry': (at, child, with_covariance, twist),
    }  # fmt: skip
    return bytes(STORE.serialize_cdr(kinds[kind](*content[kind]), kind))


TYPES = [
    'geometry_msgs/msg/PoseStamped',
    'geometry_msgs/msg/PoseWithCovarianceStamped',
    'geometry_msgs/msg/TransformStamped',
    'nav_msgs/msg/Odometry',
]


@pytest.mark.parametrize('frame', ['leica', 't', 'a_longer_name'])
@pytest.mark.parametrize('kind', TYPES)
def test_types_that_hold_a_point_in_any_frame_of_a_topic_that_is_named(tmp_path, kind, frame):
    messages = [
        ('/leica/target', kind, int(t), stamped(kind, t, p, frame))
        for t, p in zip(STAMPS, XYZ, strict=True)
    ]
    messages.append(('/cell/path', PATH_TYPE, START, path_cdr(frame='base')))
    bag = write_mcap(tmp_path / 'run.mcap', messages)
    content = read_content([bag], ReadingOptions(topic='leica/target', path_topic='/cell/path'))
    np.testing.assert_array_equal(content.samples.xyz, XYZ)
    np.testing.assert_array_equal(content.samples.stamp_ns, STAMPS)
    np.testing.assert_array_equal(content.path.points, CORNERS)
    same = read_content([bag])  # each is the only topic of its kind
    np.testing.assert_array_equal(same.samples.xyz, XYZ)
    np.testing.assert_array_equal(same.path.points, CORNERS)
    messages.append(('/leica/other', *messages[0][1:]))
    two = write_mcap(tmp_path / 'two.mcap', messages)
    with pytest.raises(InputError, match=r'/tracker/point .*topic: /leica/ot'):
        read_content([two])


def test_samples_of_another_child_are_left_out(tmp_path):
    kind = 'geometry_msgs/msg/TransformStamped'
    messages = [
        ('/tf_point', kind, int(t), stamped(kind, t, p, 'tracker', 'probe' if k == 7 else 'smr'))
        for k, (t, p) in enumerate(zip(STAMPS, XYZ, strict=True))
    ]
    bag = write_mcap(tmp_path / 'run.mcap', messages)
    samples = points_of(open_reading(bag, ReadingOptions(topic='/tf_point')), bag)
    np.testing.assert_array_equal(samples.xyz, np.delete(XYZ, 7, axis=0))


def test_a_path_that_is_given_takes_the_place_of_that_of_a_bag(tmp_path):
    bag = write_mcap(tmp_path / 'run.mcap', point_messages())
    with pytest.raises(InputError, match='/planner/path'):
        read_content([bag])
    write_points(tmp_path / 'path.csv', 0.5 * CORNERS)
    content = read_content([bag], ReadingOptions(path=tmp_path / 'path.csv'))
    np.testing.assert_array_equal(content.path.points, 0.5 * CORNERS)
    np.testing.assert_array_equal(content.samples.xyz, CONTENT.samples.xyz)
    with pytest.raises(ConfigError, match='--columns'):
        read_content([bag], ReadingOptions(columns='x,y,z'))

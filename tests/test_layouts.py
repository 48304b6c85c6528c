# SPDX-License-Identifier: Apache-2.0
"""Ready layouts name only what the graph really has: topics, their types, fields, namespaces."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from std_msgs.msg import Float64

from otf_calibrator.publish import NAMES
from otf_core.live.layers import Track, moving, scene
from otf_core.model.evaluation import VolumeErrors
from otf_core.model.frames import RigidTransform
from otf_core.model.path import NominalPath
from otf_msgs.msg import CalibrationResult, CalibratorState

MARKERS = 'visualization_msgs/msg/MarkerArray'
KINDS = {
    '/calibrator/state': CalibratorState,
    '/calibrator/result': CalibrationResult,
}
OTHERS = {
    '/view/scene': MARKERS,
    '/view/live': MARKERS,
    '/view/distance_from_path': 'std_msgs/msg/Float64',
}
"""Types of the topics of Foxglove's layout."""
VECTOR = {'X', 'Y', 'Z'}
RVIZ = {
    'Displays': {'Class', 'Name', 'Property Tree Widget'},
    'Views': {'Class', 'Current', 'Name', 'Saved'},
    'Grid': {'Alpha', 'Cell Size', 'Color', 'Line Style', 'Normal Cell Count', 'Offset', 'Plane',
             'Plane Cell Count', 'Reference Frame'},
    'Axes': {'Length', 'Radius', 'Reference Frame'},
    'TF': {'All Enabled', 'Frame Timeout', 'Frames', 'Marker Scale', 'Show Arrows', 'Show Axes',
           'Show Names', 'Tree', 'Update Interval'},
    'MarkerArray': {'Namespaces', 'Topic'},
    'Orbit': {'Distance', 'Enable Stereo Rendering', 'Focal Point', 'Focal Shape Fixed Size',
              'Focal Shape Size', 'Invert Z Axis', 'Name', 'Near Clip Distance', 'Pitch',
              'Target Frame', 'Value', 'Yaw'},
    'Measure': {'Line color'},
    'Line Style': {'Line Width', 'Value'},
    'Topic': {'Depth', 'Durability Policy', 'Filter size', 'History Policy',
              'Reliability Policy', 'Value'},
    'Global Options': {'Background Color', 'Fixed Frame', 'Frame Rate'},
    'Offset': VECTOR,
    'Focal Point': VECTOR,
}  # fmt: skip
"""Names of properties in rviz_common and rviz_default_plugins, branch jazzy of ros2/rviz."""
FOXGLOVE = {
    '3D': {'cameraState', 'followMode', 'followTf', 'layers', 'scene', 'topics', 'transforms'},
    'Indicator': {'fallbackColor', 'fallbackLabel', 'path', 'rules', 'style'},
    'Gauge': {'colorMap', 'colorMode', 'gradient', 'maxValue', 'minValue', 'path', 'reverse'},
    'Plot': {'isSynced', 'legendDisplay', 'minYValue', 'paths', 'showLegend',
             'showPlotValuesInLegend', 'showXAxisLabels', 'showYAxisLabels', 'sidebarDimension',
             'xAxisVal'},
    'RawMessages': {'diffEnabled', 'diffMethod', 'diffTopicPath', 'showFullMessageForDiff',
                    'topicPath'},
}  # fmt: skip
"""Keys of panels in foxglove.layouts of foxglove-sdk (August 2026), those used here."""
SERIES = {'value', 'enabled', 'timestampMethod', 'label', 'color', 'showLine'}


@pytest.fixture(scope='module')
def layouts():
    """Folder of the layouts as installed."""
    return Path(get_package_share_directory('otf_bringup')) / 'layouts'


def has(graph, wanted):
    """Wait until every topic of a mapping is published in the graph with its type."""

    def found():
        node = graph.ear()
        present = dict(node.get_topic_names_and_types())
        return all(present.get(t) == [kind] and node.count_publishers(t) for t, kind in wanted)

    graph.wait(found, f'the topics {sorted(wanted)}')


def rviz_topics(layouts):
    content = yaml.safe_load((layouts / 'otf.rviz').read_text())
    manager = content['Visualization Manager']
    assert manager['Global Options']['Fixed Frame'] == 'machine'
    shown = [d for d in manager['Displays'] if 'Topic' in d]
    for display in shown:
        assert display['Class'] == 'rviz_default_plugins/MarkerArray'
        assert display['Topic']['Durability Policy'] == 'Transient Local'
    return {d['Topic']['Value']: set(d['Namespaces']) for d in shown}


def panels(tree):
    """Names of the panels of a Foxglove layout."""
    if isinstance(tree, str):
        return [tree]
    assert tree['direction'] in ('row', 'column') and 0 < tree['splitPercentage'] < 100
    return panels(tree['first']) + panels(tree['second'])


def foxglove_paths(layouts):
    content = json.loads((layouts / 'foxglove.json').read_text())
    configs = content['configById']
    assert sorted(panels(content['layout'])) == sorted(configs)
    for name, config in configs.items():
        if name.startswith('3D!'):
            assert config['followTf'] == 'machine'
            yield from ((topic, '') for topic in config['topics'])
        elif name.startswith('Plot!'):
            yield from (path['value'].split('.') for path in config['paths'])
        else:
            topic, _, field = config.get('path', config.get('topicPath')).partition('.')
            yield topic, field


def classes(node):
    """Parts of an RViz configuration that name their class, with the keys that it may have."""
    for name, value in node.items():
        if isinstance(value, dict) and name in RVIZ:
            yield name, set(value), RVIZ[name]
    if node.get('Class'):
        kind = node['Class'].rpartition('/')[2]
        common = {'Class', 'Name', 'Enabled', 'Value'}
        yield kind, set(node), RVIZ.get(kind, set()) | common
    for value in node.values():
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, dict):
                yield from classes(child)


def test_layouts_hold_only_keys_that_their_programs_read(layouts):
    content = yaml.safe_load((layouts / 'otf.rviz').read_text())
    found = [(name, used - known) for name, used, known in classes(content)]
    assert {'Grid', 'Axes', 'MarkerArray', 'TF', 'Orbit', 'Topic'} <= {name for name, _ in found}
    assert [entry for entry in found if entry[1]] == []
    for name, config in json.loads((layouts / 'foxglove.json').read_text())['configById'].items():
        kind = name.partition('!')[0]
        assert set(config) - {'foxglovePanelTitle'} <= FOXGLOVE[kind], name
        assert all(set(series) <= SERIES for series in config.get('paths', ()))


def test_every_topic_of_the_layouts_is_there_with_its_type(graph, machine_file, layouts):
    graph.start('viewer')
    graph.start('calibrator', machine_file=machine_file, output_directory=graph.folder / 'out')
    wanted = {(topic, MARKERS) for topic in rviz_topics(layouts)}
    for topic, field in foxglove_paths(layouts):
        kind = KINDS.get(topic)
        wanted.add((topic, f'otf_msgs/msg/{kind.__name__}' if kind else OTHERS[topic]))
        assert not kind or not field or field in kind.get_fields_and_field_types()
    has(graph, wanted)
    assert 'data' in Float64.get_fields_and_field_types()


def test_layouts_know_every_layer_and_every_state(layouts):
    path = NominalPath(np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.2, 0], [0, 0, 0.0]]))
    pose = RigidTransform(np.eye(3), np.array([0.0, -1.0, 0.0]))
    track = Track()
    track.set_path(path)
    track.set_pose(pose)
    track.add(0.1, 1.0, 1e-5)
    volume = VolumeErrors(path.points, np.full((4, 3), 1e-5), np.full((4, 3), 1e-6))
    drawn = {'/view/scene': scene(path, volume), '/view/live': moving(path, 0.1, track, pose, 0)}
    names = {topic: {layer.name for layer in layers} for topic, layers in drawn.items()}
    assert rviz_topics(layouts) == names
    content = json.loads((layouts / 'foxglove.json').read_text())['configById']
    rules = content['Indicator!otf_state']['rules']
    assert {rule['rawValue'] for rule in rules} == set(NAMES.values())

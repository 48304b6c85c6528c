# SPDX-License-Identifier: Apache-2.0
"""What every registered backend has to do, by itself and in the node; and that of the how-to."""

import dataclasses
import re
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from backend_sources import SOURCES
from cells import SHORT
from geometry_msgs.msg import PointStamped
from graph import PATIENCE
from rcl_interfaces.srv import DescribeParameters

from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError, OtfError
from otf_core.model.machine import load_machine
from otf_core.planning.path_creation import plan_path
from otf_msgs.msg import CalibratorState
from otf_ros import qos
from otf_tracker_driver import backends
from otf_tracker_driver.backends import BACKENDS, CommonConfig

PAGE = Path(__file__).parents[1] / 'docs/extend.md'
FROM_PAGE = 'csv'
ENOUGH = 200
"""samples"""

in_the_node = pytest.mark.parametrize('name', ['simulated', 'emscon'])


@pytest.fixture
def page(monkeypatch, tmp_path):
    """The backend of the how-to, registered as it says there."""
    text = PAGE.read_text().split('## A backend')[1]
    file, source = re.findall(r'```python\n(.*?)```', text, re.DOTALL)
    (tmp_path / f'{FROM_PAGE}.py').write_text(file)
    line = re.search(r"^    '(csv\.\w+)',$", text, re.MULTILINE)[1]
    monkeypatch.setattr(backends, '__path__', [*backends.__path__, str(tmp_path)])
    monkeypatch.setitem(BACKENDS, *backends._loaded(line))
    namespace = {}
    exec(source, namespace)
    monkeypatch.setitem(SOURCES, FROM_PAGE, namespace[FROM_PAGE])
    yield
    del sys.modules[f'{backends.__name__}.{FROM_PAGE}']


@pytest.fixture(params=[*BACKENDS, FROM_PAGE])
def name(request):
    """Name of a backend; that of the how-to exists for the moment only."""
    if request.param == FROM_PAGE:
        request.getfixturevalue('page')
    return request.param


@pytest.fixture
def source(name, tmp_path):
    """Usable parameters, and what to change in them so that connecting fails."""
    assert name in SOURCES, f'add a source of {name} to tests/backend_sources.py'
    with contextmanager(SOURCES[name])(tmp_path) as given:
        yield given


@pytest.fixture
def make(name):
    """Make the backend of parameters that have their names in the node."""
    made = []

    def make(parameters):
        own = {k.partition('.')[2]: v for k, v in parameters.items() if k.startswith(f'{name}.')}
        common = {k: v for k, v in parameters.items() if not k.startswith(f'{name}.')}
        kind = BACKENDS[name]
        made.append(kind(CommonConfig(**common), kind.parameters(**own)))
        return made[-1]

    yield make
    for backend in made:
        backend.stop()
        backend.disconnect()


def prepare(backend, machine_file):
    config = PlannerConfig(**SHORT)
    plan = plan_path(load_machine(machine_file), config) if backend.needs_plan else None
    backend.prepare(plan)
    until(lambda: not backend.preparing)


def until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, 'waited in vain'
        time.sleep(0.005)


def streamed(backend):
    """Start, take samples until there are enough, stop; returns stamps and points."""
    batches = []
    backend.start()

    def enough():
        batches.append(backend.poll())
        return backend.finished or sum(map(len, batches)) >= ENOUGH

    until(enough)
    backend.stop()
    stamps = np.concatenate([batch.stamp_ns for batch in batches])
    return stamps, np.concatenate([batch.xyz for batch in batches])


def test_every_stream_has_points_and_strictly_increasing_stamps(make, source, machine_file):
    backend = make(source[0])
    said = backend.connect()
    assert said and '\n' not in said
    for _ in range(2):
        prepare(backend, machine_file)
        stamps, points = streamed(backend)
        assert len(stamps) >= ENOUGH
        assert stamps.dtype == np.int64 and np.all(np.diff(stamps) > 0)
        assert points.dtype == np.float64 and np.all(np.isfinite(points))
    assert backend.path is None or backend.brings_path


def test_stop_and_disconnect_are_possible_at_any_time(make, source, machine_file):
    for connected, prepared in ((False, False), (True, False), (True, True)):
        backend = make(source[0])
        if connected:
            backend.connect()
        if prepared:
            prepare(backend, machine_file)
            backend.start()
        backend.stop()
        backend.stop()
        backend.disconnect()


def test_source_that_cannot_be_used_is_named_in_one_line(make, source):
    usable, unusable = source
    backend = make({**usable, **unusable})
    with pytest.raises(OtfError) as caught:
        backend.connect()
    said = str(caught.value)
    assert '\n' not in said and all(str(value) in said for value in unusable.values())
    backend.disconnect()


def test_required_parameter_is_asked_for_by_the_name_it_has_in_the_node(name, make, source):
    for info in BACKENDS[name].parameters.infos():
        if 'required' in info.meaning:
            full = f'{name}.{info.name}'
            backend = make({**source[0], full: info.default})
            with pytest.raises(ConfigError, match=f'^parameter {full}: missing; '):
                backend.connect()


def test_parameters_are_described_bounded_and_frozen(name):
    kind = BACKENDS[name].parameters
    with pytest.raises(dataclasses.FrozenInstanceError):
        kind().more = 1
    for info in kind.infos():
        assert len(info.meaning) > 10, info.name
        assert getattr(kind(), info.name) == info.default
        if isinstance(info.default, (int, float)) and not isinstance(info.default, bool):
            assert info.low <= info.default <= info.high
            for beyond in (info.low - 1, info.high + 1):
                with pytest.raises(ConfigError, match=f'^{info.name}: .*out of range'):
                    kind(**{info.name: type(info.default)(beyond)})


@in_the_node
def test_node_is_configured_once_the_source_is_right_and_streams_from_the_beginning_when_active(
    graph, name, source
):
    usable, unusable = source
    points = graph.listen(PointStamped, 'tracker/point', qos.MEASUREMENT)
    graph.ear().create_publisher(CalibratorState, 'calibrator/state', qos.STATUS)  # waited for
    given = {'backend': name, 'auto_start': False, **usable, **unusable}
    graph.start('tracker_driver', **given)
    assert not graph.transition('configure')
    said = graph.wait_for_status('FAULT').message
    assert all(str(value) in said for value in unusable.values())
    before = {info.name: info.default for info in CommonConfig.infos()}
    before |= {f'{name}.{i.name}': i.default for i in BACKENDS[name].parameters.infos()}
    for changed in unusable:
        value = usable.get(changed, before[changed])
        assert graph.set_parameter('tracker_driver', changed, value).successful
    assert graph.transition('configure')
    assert graph.lifecycle_state() == 'inactive'
    if BACKENDS[name].needs_plan:
        graph.start('path_planner', machine_file=usable['machine_file'], **SHORT)
    streams = []
    for _ in range(2):
        assert graph.transition('activate')
        status = graph.wait_for_status('STREAMING')
        streams.append(status.stream_id)
        assert status.backend == name
        graph.wait(lambda: len(points) >= ENOUGH, 'samples')
        assert graph.transition('deactivate')
        published = graph.wait_for_status('IDLE', 'stopped').samples_published
        graph.wait(lambda n=published: len(points) >= n, 'the last samples')
        assert len(points) == published
        stamps = [p.header.stamp.sec * 10**9 + p.header.stamp.nanosec for p in points]
        assert all(np.diff(stamps) > 0)
        assert {p.header.frame_id for p in points} == {'tracker'}
        points.clear()
    assert streams[0] != streams[1]
    assert graph.transition('cleanup')


@in_the_node
def test_node_says_what_is_wrong_in_one_error_and_ends_with_its_code(run_here, name, source):
    usable, unusable = source
    code, said = run_here('tracker_driver', backend=name, **{**usable, **unusable})
    errors = [line for line in said.splitlines() if line.startswith('error: ')]
    assert code in (2, 3) and len(errors) == 1, said
    assert all(str(value) in errors[0] for value in unusable.values())
    assert 'Traceback' not in said


def test_node_describes_and_checks_the_parameters_of_all_backends(graph):
    node = graph.start('tracker_driver', ['-p', 'bag:=x'], auto_start=False)
    infos = {
        f'{name}.{info.name}': info
        for name, backend in BACKENDS.items()
        for info in backend.parameters.infos()
    }
    request = DescribeParameters.Request(names=list(infos))
    answer = graph.call(DescribeParameters, 'tracker_driver/describe_parameters', request)
    for described in answer.descriptors:
        info = infos[described.name]
        assert info.meaning in described.description and info.unit in described.description
        limits = described.floating_point_range or described.integer_range
        if info.low is not None:
            assert (limits[0].from_value, limits[0].to_value) == (info.low, info.high)
            beyond = type(info.default)(info.high + 1)
            refused = graph.set_parameter('tracker_driver', described.name, beyond)
            assert not refused.successful and described.name in refused.reason
    assert len(answer.descriptors) == len(infos)
    refused = graph.set_parameter('tracker_driver', 'auto_start', True)
    assert not refused.successful and 'read-only' in refused.reason
    assert "'bag' is unknown here; did you mean 'replay.bag'?" in node.last_lines(100)

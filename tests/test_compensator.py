# SPDX-License-Identifier: Apache-2.0
"""Compensator: what it commands brings the target where it is wanted, by exact kinematics."""

import json
from dataclasses import replace

import numpy as np
import policies
import pytest
from cells import ERROR_SIZE
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point

from otf_core.model.chain import exact_position
from otf_core.model.machine import load_machine
from otf_core.model.tables import ErrorTables, MotionTable
from otf_core.prediction.calibration_document import tables_to_dict
from otf_core.sim.cell import random_tables
from otf_msgs.msg import ErrorTables as ErrorTablesMessage
from otf_msgs.srv import Compensate
from otf_ros import qos

SECOND_ORDER = 5e-8
"""m; what the first order of the tables leaves of errors of 50 um."""


@pytest.fixture
def truth(tmp_path, machine_file):
    """True errors of a machine, with uncertainties, as error_tables.json."""
    found = random_tables(load_machine(machine_file), ERROR_SIZE, np.random.default_rng(5))
    motions = {
        name: MotionTable(t.position, t.value, np.full_like(t.value, 1e-7), True)
        for name, t in found.motions.items()
    }
    tables = replace(found, motions=motions)
    (tmp_path / 'tables.json').write_text(json.dumps(tables_to_dict(tables)))
    return tables


def points(truth: ErrorTables, count, seed=1):
    machine = truth.machine
    return np.random.default_rng(seed).uniform(machine.lower, machine.upper, (count, 3))


def array(vectors):
    return np.array([(v.x, v.y, v.z) for v in vectors])


def test_service_answers_what_to_command(graph, truth, tmp_path):
    graph.start('compensator', tables_file=tmp_path / 'tables.json')
    wanted = points(truth, 20)
    request = Compensate.Request(wanted=[Point(x=x, y=y, z=z) for x, y, z in wanted.tolist()])
    answer = graph.call(Compensate, 'compensator/compensate', request)
    assert answer.success and not answer.message
    policies.check(graph.ear(), 'compensator')
    found = answer.compensations
    np.testing.assert_array_equal(array(c.wanted for c in found), wanted)
    reached = exact_position(truth, array(c.corrected for c in found))
    before = np.linalg.norm(exact_position(truth, wanted) - wanted, axis=1)
    assert np.linalg.norm(reached - wanted, axis=1).max() < SECOND_ORDER < 0.02 * before.max()
    error = exact_position(truth, wanted) - wanted
    np.testing.assert_allclose(array(c.error for c in found), error, atol=SECOND_ORDER)
    assert all(c.uncertainty.x > 1e-7 and c.inside for c in found)
    for x in (100.0, float(truth.machine.upper[0]) + 1e-3):
        outside = Compensate.Request(wanted=[Point(x=x, y=0.0, z=0.0)])
        answer = graph.call(Compensate, 'compensator/compensate', outside)
        assert not answer.success and f'pose 1 of 1: X = {x:g} m is outside' in answer.message


def test_tables_are_read_anew_and_stay_if_they_cannot_be(graph, truth, tmp_path):
    file = tmp_path / 'tables.json'
    graph.start('compensator', tables_file=file)
    assert graph.trigger('compensator/reload').success
    file.write_text('{}')
    refused = graph.trigger('compensator/reload')
    assert not refused.success and 'the previous tables stay in use' in refused.message
    request = Compensate.Request(wanted=[Point(x=0.1, y=0.0, z=-0.1)])
    assert graph.call(Compensate, 'compensator/compensate', request).success


def test_compensator_answers_only_while_it_is_active(graph, truth, tmp_path):
    graph.start('compensator', tables_file=tmp_path / 'tables.json', auto_start=False)
    found = graph.listen(DiagnosticArray, '/diagnostics', qos.DIAGNOSTICS)
    request = Compensate.Request(wanted=[Point(x=0.1, y=0.1, z=-0.1)])

    def ask():
        return graph.call(Compensate, 'compensator/compensate', request)

    assert graph.lifecycle_state('compensator') == 'unconfigured'
    assert not ask().success and 'configure and activate it' in ask().message
    assert not graph.trigger('compensator/reload').success
    assert graph.transition('configure', 'compensator')
    assert not ask().success
    assert graph.transition('activate', 'compensator')
    assert ask().success and len(ask().compensations) == 1
    graph.wait(
        lambda: found and {s.hardware_id for s in found[-1].status} == {truth.machine.name},
        'diagnostics of the machine',
    )
    published = graph.ear().create_publisher(
        ErrorTablesMessage, 'calibrator/error_tables', qos.RESULT
    )
    other = {'run_id': 'another', 'machine': truth.machine.name, 'passed': True}
    published.publish(ErrorTablesMessage(**other))
    stated = f'run another of {truth.machine.name} is published and not in use'
    graph.wait(lambda: any(stated in s.message for s in found[-1].status), 'the calibration')
    changed = graph.set_parameter('compensator', 'tables_file', str(tmp_path / 'none.json'))
    assert changed.successful and 'at the next compensator/reload' in changed.reason
    assert graph.transition('deactivate', 'compensator')
    assert not ask().success
    assert graph.transition('cleanup', 'compensator')
    assert not graph.transition('configure', 'compensator')  # no such file
    assert graph.lifecycle_state('compensator') == 'unconfigured'

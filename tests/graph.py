# SPDX-License-Identifier: Apache-2.0
"""A node graph of real processes in a ROS domain of its own, and ears in it."""

import re
import subprocess
import sys
import time
from pathlib import Path

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from otf_bringup.processes import NodeProcess, module_of
from otf_msgs.msg import CalibrationResult, CalibratorState, TrackerStatus
from otf_ros import qos

PATIENCE = 240.0
"""s; far more than anything here takes on a busy computer."""
LOST = 'failed to send response'
"""What rclpy says when it answers a client that the node's side has not discovered yet."""
HEARD = (
    (CalibratorState, 'calibrator/state'),
    (CalibrationResult, 'calibrator/result'),
    (TrackerStatus, 'tracker/status'),
)
REACHED = {
    'configure': 'inactive',
    'activate': 'active',
    'deactivate': 'inactive',
    'cleanup': 'unconfigured',
    'shutdown': 'finalized',
}


class Graph:
    """Starts nodes, listens, calls services; ends everything and looks at the exit codes."""

    def __init__(self, domain, folder):
        self.folder = folder
        self.nodes = []
        self.environment = {'ROS_DOMAIN_ID': str(domain), 'ROS_HOME': str(folder / 'ros')}
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self._ear = rclpy.create_node('test_ear', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._ear)
        self.heard = {}
        for kind, topic in HEARD:  # from the beginning: each node finds them as it starts
            self.listen(kind, topic)

    def start(self, name, arguments=None, **parameters):
        """Start one of path_planner, tracker_driver, calibrator, viewer, page."""
        if name == 'calibrator':  # journals have to lie apart
            parameters.setdefault('output_directory', self.folder / 'out')
        label = f'{name}-{len(self.nodes)}'
        module = module_of(name)
        node = NodeProcess(label, module, parameters, self.folder, self.environment, arguments)
        self.nodes.append(node)
        return node

    def listen(self, kind, topic, profile=qos.STATUS):
        """Collect the messages of a topic in a list."""
        if topic not in self.heard:
            self.heard[topic] = []
            self._ear.create_subscription(kind, topic, self.heard[topic].append, profile)
        return self.heard[topic]

    def wait(self, condition, what, timeout=PATIENCE, ended=()):
        """Spin until the condition holds; nodes may not end meanwhile, except those named."""
        deadline = time.monotonic() + timeout
        while not condition():
            self._executor.spin_once(timeout_sec=0.05)
            for node in self.nodes:
                if node.exit_code is not None and node not in ended:
                    raise AssertionError(
                        f'{node.name} ended early: {node.exit_code}\n{self.logs()}'
                    )
            if time.monotonic() > deadline:
                raise AssertionError(f'waited {timeout} s for {what}\n{self.logs()}')

    def state(self):
        """Latest state of the calibrator."""
        heard = self.listen(CalibratorState, 'calibrator/state')
        return heard[-1] if heard else None

    def status(self):
        """Latest status of the driver."""
        heard = self.listen(TrackerStatus, 'tracker/status')
        return heard[-1] if heard else None

    def wait_for_state(self, name, timeout=PATIENCE):
        """Wait for a state of the calibrator and return it."""
        self.wait(lambda: self.state() and self.state().name == name, f'state {name}', timeout)
        return self.state()

    def wait_for_status(self, name, part=''):
        """Wait for a status of the driver whose message has this part, and return it."""

        def reached():
            status = self.status()
            return status and status.name == name and part in status.message

        self.wait(reached, f'status {name}: {part}')
        return self.status()

    def wait_for_result(self, count=1):
        """Wait for the result number ``count`` and for the state after it; return both."""
        heard = self.listen(CalibrationResult, 'calibrator/result')
        self.wait(lambda: len(heard) >= count, f'result {count}')
        self.wait(lambda: self.state() and self.state().name in ('DONE', 'FAILED'), 'its state')
        return heard[-1], self.state()

    def call(self, kind, name, request=None):
        """Call a service and return its answer."""
        client = self._ear.create_client(kind, name)
        try:
            self.wait(client.service_is_ready, f'service {name}')
            answer = None
            while answer is None:
                answer = self._answer(client.call_async(request or kind.Request()), name)
            return answer
        finally:
            self._ear.destroy_client(client)

    def _answer(self, future, name):
        """Answer of a service, or None if it was lost on its way."""
        lost = self._lost_answers()
        self.wait(lambda: future.done() or self._lost_answers() > lost, f'answer of {name}')
        return future.result() if future.done() else None

    def _lost_answers(self):
        return sum(node.log.read_text(errors='replace').count(LOST) for node in self.nodes)

    def trigger(self, name):
        """Call a Trigger service."""
        return self.call(Trigger, name)

    def transition(self, label, node='tracker_driver'):
        """Ask a node for a lifecycle transition; True if it was made."""
        request = ChangeState.Request(transition=Transition(label=label))
        lost = self._lost_answers()
        made = self.call(ChangeState, f'{node}/change_state', request).success
        if self._lost_answers() > lost:  # asked twice: the second time it may be made already
            return self.lifecycle_state(node) == REACHED[label]
        return made

    def lifecycle_state(self, node='tracker_driver'):
        """Lifecycle state of a node."""
        return self.call(GetState, f'{node}/get_state').current_state.label

    def set_parameter(self, node, name, value):
        """Set a parameter of a node; returns whether it was accepted, and why not."""
        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        return self.call(SetParameters, f'{node}/set_parameters', request).results[0]

    def ear(self):
        """The node that listens, for whatever is not offered here."""
        return self._ear

    def logs(self):
        """Everything the nodes have said."""
        return '\n'.join(f'--- {node.name}\n{node.last_lines(40)}' for node in self.nodes)

    def stop(self, node, expect=0):
        """End a node with SIGINT; its exit code has to be as expected."""
        node.interrupt()
        code = node.wait()
        self.nodes.remove(node)
        assert code == expect, node.last_lines(40)
        assert 'Traceback' not in node.last_lines(1000)

    def close(self):
        """End all nodes; none may have needed force, none may have complained."""
        self._executor.shutdown()
        self._ear.destroy_node()
        rclpy.shutdown(context=self._context)
        for node in self.nodes:
            node.interrupt()
        codes = {node.name: node.wait() for node in self.nodes}
        text = '\n'.join(node.log.read_text(errors='replace') for node in self.nodes)
        assert not any(codes.values()) and 'Traceback' not in text, f'{codes}\n{self.logs()}'


def without_date(content):
    """Bytes of a result but for the moment of writing, all that may differ from offline."""
    return re.sub(rb'"written": "[^"]*"', b'', content)


def offline(bag, machine_file, folder, *options):
    """Run ``./otf calibrate`` in a process of its own; returns its tables as ``without_date``."""
    _run_verb('calibrate', bag, machine_file, folder, *options)
    return without_date(Path(folder, 'error_tables.json').read_bytes())


def offline_diagnosis(bag, machine_file, folder, *options):
    """Run ``./otf diagnose`` in a process of its own; returns its gap.json likewise."""
    _run_verb('diagnose', bag, machine_file, folder, *options)
    return without_date(Path(folder, 'gap.json').read_bytes()).decode()


def _run_verb(verb, bag, machine_file, folder, *options):
    command = [sys.executable, '-m', 'otf_core.cli', verb, str(bag)]
    command += ['--machine', str(machine_file), '--out', str(folder), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr

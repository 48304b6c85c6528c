# SPDX-License-Identifier: Apache-2.0
"""A client of the action ``calibrator/calibrate``."""

from rclpy.action import ActionClient

from otf_msgs.action import Calibrate


class Caller:
    """Sends goals and waits for what comes of them."""

    def __init__(self, graph):
        self._graph = graph
        self._client = ActionClient(graph.ear(), Calibrate, 'calibrator/calibrate')
        graph.wait(self._client.server_is_ready, 'the action')
        self.feedback = []

    def send(self):
        """Send a goal; return its handle once it is accepted."""
        self.feedback.clear()
        sending = self._client.send_goal_async(
            Calibrate.Goal(), feedback_callback=lambda m: self.feedback.append(m.feedback)
        )
        self._graph.wait(sending.done, 'acceptance')
        assert sending.result().accepted
        return sending.result()

    def outcome(self, goal):
        """Wait for the end of a goal; return status and result."""
        asking = goal.get_result_async()
        self._graph.wait(asking.done, 'the result')
        return asking.result().status, asking.result().result

    def close(self):
        self._client.destroy()

# SPDX-License-Identifier: Apache-2.0
"""Lifecycle node that survives a transition request which its present state does not allow."""

from __future__ import annotations

from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode


class SteadyLifecycleNode(LifecycleNode):
    """LifecycleNode whose ``change_state`` service answers False where rclpy ends the process."""

    def __init__(self, node_name: str, **options: Any) -> None:
        super().__init__(node_name, **options)
        service = self._service_change_state
        change_state = service.callback

        def answer(request: Any, response: Any) -> Any:
            try:
                return change_state(request, response)
            except rclpy_implementation.RCLError:
                wanted = request.transition.label or request.transition.id
                self.get_logger().warning(f'transition {wanted} is not possible in this state')
                response.success = False
                return response

        service.callback = answer

    @property
    def lifecycle_state(self) -> str:
        """Label of the lifecycle state, such as 'inactive'."""
        return str(self._state_machine.current_state[1])

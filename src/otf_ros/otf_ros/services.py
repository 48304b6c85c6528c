# SPDX-License-Identifier: Apache-2.0
"""Services of type Trigger: an action that tells whether it was done (docs/why.md)."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from concurrent.futures import Future

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from otf_core.errors import OtfError

STEP = 0.002
"""s; how often work that a service waits for is looked at."""


def offer(node: Node, name: str, action: Callable[[], tuple[bool, str]]) -> None:
    """Offer a service; what it answers is logged as well.

    Parameters
    ----------
    action : callable
        Returns at once: success, and one sentence on what was done or what to do first.
    """

    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = action()
        return _logged(node, name, response)

    node.create_service(Trigger, name, answer)


def offer_lasting(node: Node, name: str, begin: Callable[[], Future[str]]) -> None:
    """Offer a service whose work takes time; the node goes on meanwhile.

    Parameters
    ----------
    begin : callable
        Returns at once; its future gives one sentence on what came of it. OtfError, at once or
        later, is answered as a failure.
    """

    async def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            work = begin()
            await _Ended(work)
            response.success = not work.cancelled()
            response.message = work.result() if response.success else 'given up'
        except OtfError as error:
            response.success, response.message = False, str(error)
        return _logged(node, name, response)

    node.create_service(Trigger, name, answer, callback_group=ReentrantCallbackGroup())


class _Ended:
    """Lets an executor of rclpy do other things until work of another thread has ended."""

    def __init__(self, work: Future[str]) -> None:
        self._work = work

    def __await__(self) -> Generator[None, None, None]:
        while not self._work.done():
            time.sleep(STEP)  # the executor resumes what waits as often as it can
            yield


def _logged(node: Node, name: str, response: Trigger.Response) -> Trigger.Response:
    if response.success:  # rclpy wants one severity per line of code
        node.get_logger().info(f'{name}: {response.message}')
    else:
        node.get_logger().warning(f'{name}: {response.message}')
    return response

# SPDX-License-Identifier: Apache-2.0
"""Services ``tracker/...`` for what an operator wants of the source; docs/decisions/0008."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial

from otf_ros import services
from otf_ros.lifecycle import SteadyLifecycleNode
from otf_tracker_driver.backends.base import OPERATIONS
from otf_tracker_driver.status import Status


def offer_operations(
    node: SteadyLifecycleNode,
    status: Status,
    operate: Callable[[str], Future[str]],
    under_way: Callable[[], bool],
) -> None:
    """Offer all services of the driver.

    Parameters
    ----------
    status : Status
        Tells how a start has ended.
    operate : callable
        Begins one of ``OPERATIONS``; OtfError if it cannot be.
    under_way : callable
        Tells whether a stream goes on or is about to.
    """
    services.offer(node, 'tracker/start', partial(_start, node, status, under_way))
    services.offer(node, 'tracker/stop', partial(_stop, node, status))
    for name in OPERATIONS:
        services.offer_lasting(node, f'tracker/{name}', partial(operate, name))


def _start(
    node: SteadyLifecycleNode, status: Status, under_way: Callable[[], bool]
) -> tuple[bool, str]:
    """Configure and activate, as far as that is not done; again where a stream has ended."""
    if node.lifecycle_state == 'active':
        if under_way():
            return False, 'a stream is under way; call tracker/stop first'
        node.trigger_deactivate()
    if node.lifecycle_state == 'unconfigured':
        node.trigger_configure()
    if node.lifecycle_state == 'inactive':
        node.trigger_activate()
    started = node.lifecycle_state == 'active'
    return started, f'{status.message.name}: {status.message.message}'


def _stop(node: SteadyLifecycleNode, status: Status) -> tuple[bool, str]:
    if node.lifecycle_state != 'active':
        return False, f'no stream to stop: {status.message.message}'
    node.trigger_deactivate()
    return True, 'stopped; tracker/start streams from the beginning'

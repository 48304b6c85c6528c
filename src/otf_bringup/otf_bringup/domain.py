# SPDX-License-Identifier: Apache-2.0
"""A ROS domain of one's own, so that graphs on one computer do not hear each other."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager

HIGHEST = 100
"""Domains up to here use ports below those that the system hands out."""
_LOCK_PORT = 32768
"""The package domain_coordinator reserves a domain by holding this TCP port plus its number."""


def _discovery_ports(domain: int) -> tuple[int, int]:
    base = 7400 + 250 * domain
    return base, base + 10


def _in_use(domain: int) -> bool:
    for port in _discovery_ports(domain):
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
            try:
                probe.bind(('', port))
            except OSError:
                return True
    return False


@contextmanager
def free_domain() -> Iterator[int]:
    """Reserve a domain that nobody uses, as long as the context lasts.

    Raises
    ------
    RuntimeError
        If there is none.
    """
    for domain in random.sample(range(1, HIGHEST + 1), HIGHEST):
        with closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as lock:
            try:
                lock.bind(('', _LOCK_PORT + domain))
            except OSError:
                continue
            if not _in_use(domain):
                yield domain
                return
    raise RuntimeError(f'all ROS domains from 1 to {HIGHEST} are in use')

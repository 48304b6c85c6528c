# SPDX-License-Identifier: Apache-2.0
"""What the nodes need: ROS 2 Jazzy, its variables, ports. Offline verbs do without."""

from __future__ import annotations

import os
import shutil
import socket
import sys
from collections.abc import Iterator
from importlib.util import find_spec

from otf_core.installation.state import OK, WARNING, State

DOMAINS = 232
"""Highest ROS_DOMAIN_ID: its ports end at 65535 (docs.ros.org, The ROS_DOMAIN_ID)."""
FIRST_PORT, PER_DOMAIN = 7400, 250
"""UDP ports of discovery (DDSI-RTPS 2.3, 9.6.1.1)."""
TOOLS = (('cc', 'gcc', 'clang'), ('c++', 'g++', 'clang++'), ('cmake',), ('make',))
"""Programs of which one each builds the messages."""
EMSCON = 700
"""TCP port of a tracker controller."""


def check() -> Iterator[State]:
    """Ask for ROS, domain, discovery and ports."""
    yield _ros()
    domain = os.environ.get('ROS_DOMAIN_ID', '') or '0'
    if not domain.isascii() or not domain.isdigit() or int(domain) > DOMAINS:
        yield State(
            'domain', WARNING, f'ROS_DOMAIN_ID={domain}',
            f'set a number of 0 to 101 (at most {DOMAINS}), the same on all computers',
        )  # fmt: skip
    else:
        yield _discovery(int(domain))
    for name in ('ROS_LOCALHOST_ONLY', 'ROS_AUTOMATIC_DISCOVERY_RANGE'):
        value = os.environ.get(name, '')
        if value and value.upper() not in ('0', 'SUBNET', 'SYSTEM_DEFAULT'):
            yield State(
                'discovery', WARNING, f'{name}={value}',
                'unset it if nodes run on several computers',
            )  # fmt: skip
    if sys.platform == 'linux' and hasattr(os, 'geteuid') and os.geteuid() and not _low_ports():
        yield State(
            'ports', OK, f'TCP {EMSCON} is for root alone: ./otf emulate-tracker --port 7000',
        )  # fmt: skip


def _ros() -> State:
    distribution = os.environ.get('ROS_DISTRO', '')
    if distribution and distribution != 'jazzy':
        return State(
            'ros', WARNING, f'ROS_DISTRO={distribution}',
            'the nodes are made for jazzy: open a new terminal, source /opt/ros/jazzy/setup.bash',
        )  # fmt: skip
    lacking = [names[0] for names in TOOLS if not any(map(shutil.which, names))]
    if find_spec('rclpy') is None and lacking:
        return State(
            'ros', WARNING, f'no rclpy here, and {", ".join(lacking)} to build with: offline '
            f'verbs only',
            'sudo apt install build-essential cmake, then ./otf demo sets ROS 2 Jazzy up',
        )  # fmt: skip
    if find_spec('rclpy') is None:
        return State(
            'ros', OK, 'no rclpy here: offline verbs only (./otf demo sets ROS 2 Jazzy up)'
        )
    middleware = os.environ.get('RMW_IMPLEMENTATION', '') or 'default'
    return State('ros', OK, f'rclpy found, middleware {middleware}')


def _discovery(domain: int) -> State:
    """Whether datagrams can be sent and received on the port of discovery."""
    port = FIRST_PORT + PER_DOMAIN * domain
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            own.bind(('', port))
    except OSError as error:
        return State(
            'domain', WARNING, f'{domain}: UDP port {port} cannot be opened ({error.strerror})',
            'choose another ROS_DOMAIN_ID, or open the port in the firewall',
        )  # fmt: skip
    return State('domain', OK, f'{domain}, UDP port {port}')


def _low_ports() -> bool:
    """True if this user may listen on the port of a tracker."""
    try:
        with open('/proc/sys/net/ipv4/ip_unprivileged_port_start', encoding='ascii') as file:
            return int(file.read()) <= EMSCON
    except (OSError, ValueError):
        return False

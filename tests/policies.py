# SPDX-License-Identifier: Apache-2.0
"""What nodes really publish, subscribe and offer, against the policies of SROS 2."""

import time
import xml.etree.ElementTree as ElementTree
from fnmatch import fnmatch
from pathlib import Path

FILE = Path(__file__).parents[1] / 'src/otf_bringup/config/policies.xml'
ROLES = ('publish', 'subscribe', 'request', 'reply', 'call', 'execute')
OTHER_SIDE = {'publish': 'subscribe', 'reply': 'request', 'execute': 'call'}
ELSEWHERE = {('subscribe', '/clock'), ('publish', '/tf_static')}
ELSEWHERE |= {('publish', '/planner/path'), ('publish', '/planner/axes')}
"""With use_sim_time, with tf2_ros, and by a driver that replays a path, only."""
DISCOVERED = 20.0
"""s; what a node does is told apart from its names, and after them."""


def allowed(node):
    """Pairs of what may be done and the full name, of the enclave of a node in no namespace."""
    (profile,) = (
        profile
        for enclave in ElementTree.parse(FILE).iter('enclave')
        for profile in enclave.iter('profile')
        if profile.get('node') == node and enclave.get('path') == f'/otf/{node}'
    )
    assert profile.get('ns') == '/'
    return {
        (role, _full(item.text, node))
        for group in profile
        for role in ROLES
        if group.get(role) == 'ALLOW'
        for item in group
    }


def _full(name, node):
    return name if name.startswith('/') else '/' + name.replace('~', node)


def done(ear, node):
    """The same of a node that runs, as the graph tells; nothing while it does not know it."""
    if node not in ear.get_node_names():
        return set()
    asked = {
        'publish': ear.get_publisher_names_and_types_by_node,
        'subscribe': ear.get_subscriber_names_and_types_by_node,
        'reply': ear.get_service_names_and_types_by_node,
        'request': ear.get_client_names_and_types_by_node,
    }
    found = {(role, name) for role, ask in asked.items() for name, _ in ask(node, '/')}
    actions = {name.partition('/_action/')[0] for _, name in found if '/_action/' in name}
    plain = {(role, name) for role, name in found if '/_action/' not in name}
    return plain | {('execute', name) for name in actions}


def _used(may, does):
    """What of that which may be done is done."""
    return {
        (role, pattern)
        for role, pattern in may
        if any(role == other and fnmatch(name, pattern) for other, name in does)
    }


def check(ear, node):
    """Assert that a node does what it may and nothing else, and that nothing more is allowed."""
    may, deadline = allowed(node), time.monotonic() + DISCOVERED
    does = done(ear, node)
    while may - _used(may, does) - ELSEWHERE and time.monotonic() < deadline:
        time.sleep(0.1)
        does = done(ear, node)
    refused = {
        (role, name)
        for role, name in does
        if not any(role == other and fnmatch(name, pattern) for other, pattern in may)
    }
    assert not refused, f'{node}: {refused} not in policies.xml'
    idle = may - _used(may, does) - ELSEWHERE
    assert not idle, f'{node}: {idle} in policies.xml, but not used'
    operator = allowed('operator')
    for role, name in {(OTHER_SIDE[role], name) for role, name in does if role in OTHER_SIDE}:
        assert any(role == r and fnmatch(name, p) for r, p in operator), f'operator: {role} {name}'

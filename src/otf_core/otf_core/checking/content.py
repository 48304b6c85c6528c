# SPDX-License-Identifier: Apache-2.0
"""What is there, and whether it can be read at all."""

from __future__ import annotations

from otf_core.checking.checked import Check, Checked, errors, warnings
from otf_core.checking.seen import Seen


def _ask(seen: Seen) -> Checked:
    parts = list(seen.said)
    if seen.received is not None and not parts:
        parts.append(f'{len(seen.received.stamp_ns)} points')
    if seen.path is not None:
        parts.append(f'path of {len(seen.path.points)} corner points, {seen.path.length:.2f} m')
    facts = {
        'topics': dict(seen.topics),
        'samples': 0 if seen.received is None else len(seen.received.stamp_ns),
    }
    problems = errors(*(seen.why(step) for step in ('bag', 'points', 'path')))
    return Checked('; '.join(parts), facts, problems + warnings(*seen.remarks))


CONTENT = Check('content', _ask)

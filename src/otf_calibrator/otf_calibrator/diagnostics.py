# SPDX-License-Identifier: Apache-2.0
"""What the calibrator tells on ``/diagnostics``: samples, losses, run, disk, journal, memory."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node

from otf_calibrator.losses import lost_words
from otf_calibrator.session import Session
from otf_core.bags.journal import Journal
from otf_ros.diagnostics import PERIOD, Diagnostics, Finding, Level, disk, memory


def tell(
    node: Node, session: Session, folder: Callable[[], str], machine: Callable[[], str]
) -> Diagnostics:
    """Publish what a calibrator finds.

    Parameters
    ----------
    folder : callable
        Returns where results go.
    machine : callable
        Returns the name of the machine.
    """
    before = [0]

    def samples() -> Finding:
        count = len(session.collector.buffer)
        came, before[0] = max(0, count - before[0]), count
        values = {'samples of the run': count, 'rate [Hz]': came / PERIOD}
        return Finding(Level.OK, f'{count} samples of the present run', values)

    def losses() -> Finding:
        lost = session.collector.count_lost(time.monotonic())
        if not lost:
            return Finding(Level.OK, 'nothing is lost', {'lost': 0})
        return Finding(Level.WARN, lost_words(lost), {'lost': lost})

    def work() -> Finding:
        if session.busy:
            stage, fraction = session.progress
            return Finding(Level.OK, stage, {'done': fraction})
        return Finding(Level.OK, 'waits' if session.collector.taken else 'collects')

    tasks = {
        'samples': samples,
        'losses': losses,
        'work': work,
        'disk': lambda: disk(folder()),
        'journal': lambda: journal(session.intake.journal),
        'memory': memory,
    }
    return Diagnostics(node, machine, tasks)


def journal(writer: Journal | None) -> Finding:
    """Whether samples are on the disk as they come, and the room left there."""
    if writer is None:
        return Finding(Level.OK, 'no journal is kept')
    if writer.trouble:
        return Finding(Level.ERROR, writer.trouble)
    return disk(str(writer.directory))

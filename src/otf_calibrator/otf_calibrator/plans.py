# SPDX-License-Identifier: Apache-2.0
"""Which messages of ``planner/path`` or ``planner/axes`` make up the plan of a run.

A path is a plan by itself. Of a machine with rotary axes a part comes in each message, in driving
order. Parts of one plan have one stamp; or each its own, and then they come within two seconds of
each other, or one by one while the run is driven, before it is over. A plan that comes again from
its beginning, as after a restart of the planner or of the calibrator, is the same. Anything else
begins another plan: at once if nothing is driven yet, else after the run.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from otf_core.bags.rosbag2_metadata import AXES, PATH, Topic
from otf_core.model.axis_path import AxisPath, nominal_track
from otf_core.model.machine import Machine
from otf_core.model.path import NominalPath

TOGETHER = 2.0
"""s; parts with stamps of their own that come within this time of each other are of one plan."""
SAME_POINT, SAME = 1e-6, 1e-9
"""m; m or rad; points of a path, and corners of a part, that differ by less are the same."""
Item = NominalPath | AxisPath


class Reception(Enum):
    """What becomes of a path or part that arrives."""

    KNOWN = 'it is known already'
    ADDED = 'it is the next part of the plan'
    NEW = 'it begins a plan, which is used from now on'
    NEXT = 'it is kept for the next run; calibrator/reset switches to it at once'


@dataclass
class RunPlan:
    """A path, or parts, as they came.

    Attributes
    ----------
    items : list of NominalPath or AxisPath
    messages : list of bytes
        In which they came.
    """

    items: list[Item] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)
    _stamps: set[int] = field(default_factory=set)
    _came: float = 0.0
    _one_by_one: bool = False

    def add(self, item: Item, message: bytes, stamp_ns: int, now: float) -> None:
        """Append the next part."""
        self._one_by_one |= bool(self.items) and now - self._came >= TOGETHER
        self.items.append(item)
        self.messages.append(message)
        self._stamps.add(stamp_ns)
        self._came = now

    def mark_repeated(self, stamp_ns: int, now: float) -> None:
        """Record stamp (ns) and time (s) of a part that was received again."""
        self._stamps, self._came = {stamp_ns}, now

    def continues_with(self, item: Item, stamp_ns: int, now: float) -> bool:
        """Return whether an item received now belongs to this plan."""
        if not self.items or self.topic is PATH or isinstance(item, NominalPath):
            return False
        own_stamps = len(self._stamps) == len(self.items)
        return stamp_ns in self._stamps or (own_stamps and now - self._came < TOGETHER)

    def is_complete(self, now: float) -> bool:
        """Return whether no further part is expected: the last one was received some time ago."""
        return now - self._came >= TOGETHER

    @property
    def topic(self) -> Topic:
        """That of its messages."""
        return PATH if isinstance(self.items[0], NominalPath) else AXES

    @property
    def open(self) -> bool:
        """Whether parts come one by one, as far as is known."""
        return self._one_by_one or (len(self.items) == 1 and self.topic is AXES)

    def track(self, machine: Machine) -> NominalPath:
        """Return the path, or the track of the parts."""
        first = self.items[0]
        return first if isinstance(first, NominalPath) else nominal_track(machine, self.items)


class Plans:
    """The plan of the present run, and that of the next.

    Attributes
    ----------
    plan : RunPlan
        Of the present run.
    """

    def __init__(self) -> None:
        self.plan, self._next = RunPlan(), RunPlan()
        self._again, self._resumed = 0, False

    def take(
        self, item: Item, message: bytes, stamp_ns: int, now: float, driving: bool
    ) -> Reception:
        """Process a path or a part.

        Parameters
        ----------
        message : bytes
            In which it came.
        stamp_ns : int, ns
        now : float, s
        driving : bool
            A run is being driven.
        """
        plan, again, self._again = self.plan, self._again, 0
        if self._next.continues_with(item, stamp_ns, now):
            self._next.add(item, message, stamp_ns, now)
            return Reception.NEXT
        if again or self._begins_again(item, stamp_ns, now, driving):
            if _same(item, plan.items[again]):
                plan.mark_repeated(stamp_ns, now)
                self._again = (again + 1) % len(plan.items)
                self._next = RunPlan()  # the newest counts
                return Reception.KNOWN
            before = RunPlan(plan.items[:again], plan.messages[:again])
            before.mark_repeated(stamp_ns, now)
        elif plan.continues_with(item, stamp_ns, now) or (driving and plan.items and plan.open):
            plan.add(item, message, stamp_ns, now)
            return Reception.ADDED
        else:
            before = RunPlan()
        waiting = self._next.items
        if driving and waiting and isinstance(item, NominalPath) and _same(item, waiting[0]):
            return Reception.KNOWN
        before.add(item, message, stamp_ns, now)
        if driving:
            self._next = before
            return Reception.NEXT
        self.plan, self._next = before, RunPlan()
        return Reception.NEW

    def _begins_again(self, item: Item, stamp_ns: int, now: float, driving: bool) -> bool:
        """Return whether an item is the first of the known plan once more."""
        plan, resumed = self.plan, self._resumed
        if not plan.items or not _same(item, plan.items[0]):
            return False
        self._resumed = False
        if resumed or not driving:
            return resumed or not plan.continues_with(item, stamp_ns, now) or plan.is_complete(now)
        one_by_one = plan.open and len(plan.items) > 1
        return not one_by_one and not plan.continues_with(item, stamp_ns, now)

    def restore(self, item: Item, message: bytes, now: float) -> None:
        """Restore a path or part of a resumed run: the planner will send it again."""
        if isinstance(item, NominalPath):
            self.plan = RunPlan()
        self.plan.add(item, message, 0, now)
        self._resumed = True

    def use_next(self) -> bool:
        """Use the plan that was received during the run; return whether there is one."""
        if not self._next.items:
            return False
        self.plan, self._next, self._again = self._next, RunPlan(), 0
        return True


def _same(a: Item, b: Item) -> bool:
    if isinstance(a, NominalPath) and isinstance(b, NominalPath):
        return a.points.shape == b.points.shape and _near(a.points, b.points, SAME_POINT)
    if isinstance(a, AxisPath) and isinstance(b, AxisPath):
        alike = (a.axes, a.target, a.positions.shape) == (b.axes, b.target, b.positions.shape)
        return alike and _near(a.positions, b.positions, SAME)
    return False


def _near(a: np.ndarray, b: np.ndarray, limit: float) -> bool:
    return bool(np.abs(a - b).max() < limit)

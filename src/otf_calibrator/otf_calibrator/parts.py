# SPDX-License-Identifier: Apache-2.0
"""Which messages of ``planner/axes`` make up a plan: a part comes in each, in driving order.

Parts of one plan have one stamp; or each its own, and then they come within two seconds of each
other, or one by one while the run is driven, before it is over. A plan that comes again from its
beginning, as after a restart of the planner or of the calibrator, is the same. Any other part
begins another plan: at once if nothing is driven yet, else after the run.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from otf_core.model.axis_path import AxisPath

TOGETHER = 2.0
"""s; parts with stamps of their own that come within this time of each other are of one plan."""
SAME = 1e-9
"""m or rad; corners that differ by less are the same."""


class PartReception(Enum):
    """What becomes of a part that arrives."""

    KNOWN = 'it is known already'
    ADDED = 'it is the next part of the plan'
    NEW = 'it begins another plan, which is used from now on'
    NEXT = (
        'it belongs to another plan, which is used after this run; calibrator/reset switches to '
        'it at once'
    )


@dataclass
class PartsPlan:
    """Parts as they came.

    Attributes
    ----------
    parts : list of AxisPath
    messages : list of bytes
        In which they came.
    """

    parts: list[AxisPath] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)
    _stamps: set[int] = field(default_factory=set)
    _came: float = 0.0
    _one_by_one: bool = False

    def add(self, part: AxisPath, message: bytes, stamp_ns: int, now: float) -> None:
        """Append the next part."""
        self._one_by_one |= bool(self.parts) and now - self._came >= TOGETHER
        self.parts.append(part)
        self.messages.append(message)
        self._stamps.add(stamp_ns)
        self._came = now

    def mark_repeated(self, stamp_ns: int, now: float) -> None:
        """Record stamp (ns) and time (s) of a part that was received again."""
        self._stamps, self._came = {stamp_ns}, now

    def continues_with(self, stamp_ns: int, now: float) -> bool:
        """Return whether a part received now belongs to this plan."""
        if stamp_ns in self._stamps:
            return True
        own_stamps = len(self._stamps) == len(self.parts)
        return bool(self.parts) and own_stamps and now - self._came < TOGETHER

    def is_complete(self, now: float) -> bool:
        """Return whether no further part is expected: the last one was received some time ago."""
        return now - self._came >= TOGETHER

    @property
    def open(self) -> bool:
        """Whether parts come one by one, as far as is known."""
        return self._one_by_one or len(self.parts) == 1


class PartsCollector:
    """Assembles plans from their parts.

    Attributes
    ----------
    plan : PartsPlan
        Of the present run.
    """

    def __init__(self) -> None:
        self.plan = PartsPlan()
        self._next = PartsPlan()
        self._again = 0
        self._resumed = False

    def take(
        self, part: AxisPath, message: bytes, stamp_ns: int, now: float, driving: bool
    ) -> PartReception:
        """Process a part.

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
        if self._next.continues_with(stamp_ns, now):
            self._next.add(part, message, stamp_ns, now)
            return PartReception.NEXT
        if again or self._begins_again(part, stamp_ns, now, driving):
            if _same(part, plan.parts[again]):
                plan.mark_repeated(stamp_ns, now)
                self._again = (again + 1) % len(plan.parts)
                return PartReception.KNOWN
            before = PartsPlan(plan.parts[:again], plan.messages[:again])
            before.mark_repeated(stamp_ns, now)
        elif plan.continues_with(stamp_ns, now) or (driving and plan.open):
            plan.add(part, message, stamp_ns, now)
            return PartReception.ADDED
        else:
            before = PartsPlan()
        before.add(part, message, stamp_ns, now)
        if driving:
            self._next = before
            return PartReception.NEXT
        self.plan, self._next = before, PartsPlan()
        return PartReception.NEW

    def _begins_again(self, part: AxisPath, stamp_ns: int, now: float, driving: bool) -> bool:
        """Return whether a part is the first of the known plan once more."""
        plan, resumed = self.plan, self._resumed
        if not plan.parts or not _same(part, plan.parts[0]):
            return False
        self._resumed = False
        if resumed or not driving:
            return resumed or not plan.continues_with(stamp_ns, now) or plan.is_complete(now)
        one_by_one = plan.open and len(plan.parts) > 1
        return not one_by_one and not plan.continues_with(stamp_ns, now)

    def restore(self, part: AxisPath, message: bytes, now: float) -> None:
        """Restore a part of a resumed run: the planner will send it again."""
        self.plan.add(part, message, 0, now)
        self._resumed = True

    def use_next_plan(self) -> bool:
        """Use the plan that was received during the run; return whether there is one."""
        if not self._next.parts:
            return False
        self.plan, self._next, self._again = self._next, PartsPlan(), 0
        return True


def _same(a: AxisPath, b: AxisPath) -> bool:
    if (a.axes, a.target, a.positions.shape) != (b.axes, b.target, b.positions.shape):
        return False
    return bool(np.abs(a.positions - b.positions).max() < SAME)

# SPDX-License-Identifier: Apache-2.0
"""What is asked of recordings before they are aligned."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from otf_core.contradictions.same_samples import check_same_samples
from otf_core.contradictions.stamps import check_stamps
from otf_core.contradictions.units import check_path_in_machine
from otf_core.pieces.runs import Recording

CHECKS: tuple[Callable[[Sequence[Recording]], None], ...] = (
    check_same_samples,
    check_path_in_machine,
    check_stamps,
)


def check_recordings(recordings: Sequence[Recording]) -> None:
    """Run all checks; InputError says what is wrong, where, and what to do."""
    for check in CHECKS:
        check(recordings)

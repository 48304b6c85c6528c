# SPDX-License-Identifier: Apache-2.0
"""What contradicts itself: axes, chain, noise, steps of the tracker (room contradictions)."""

from __future__ import annotations

from otf_core.checking.checked import Check, Checked, errors, warnings
from otf_core.checking.seen import Seen
from otf_core.pieces.finding import GATE, WARNING, words_of


def _ask(seen: Seen) -> Checked:
    if seen.machine is None or seen.run is None:
        return Checked()
    findings = seen.findings
    doubtful = errors(*words_of(findings, GATE)) + warnings(*words_of(findings, WARNING))
    words = ', '.join(f.check for f in findings) or 'no contradictions'
    return Checked(f'{seen.machine.name}, chain {seen.machine.chain}: {words}', {}, doubtful)


CONTRADICTION = Check('machine', _ask)

# SPDX-License-Identifier: Apache-2.0
"""Where samples are missing."""

from __future__ import annotations

import numpy as np

from otf_core.checking.checked import Check, Checked, warnings
from otf_core.checking.seen import Seen
from otf_core.noise.events import lost_samples
from otf_core.tracking.track import broken

MUCH = 0.01
"""Share of the samples that may be missing without a word."""
SHOWN = 3


def _ask(seen: Seen) -> Checked:
    samples = seen.samples
    if samples is None or len(samples) < 3:
        return Checked(facts={'gaps': 0, 'lost_share': 0.0, 'longest_gap_s': 0.0})
    lost, time = lost_samples(samples), samples.time
    at = np.flatnonzero(broken(samples))
    length = time[at + 1] - time[at]
    share = lost.samples / (lost.samples + len(samples))
    longest = float(length.max()) if len(at) else 0.0
    facts = {'gaps': len(at), 'lost_share': share, 'longest_gap_s': longest}
    if not len(at):
        few = f', {lost.samples} single samples lost' if lost.samples else ''
        return Checked(f'none{few}', facts)
    words = f'{len(at)}, {100 * share:.1f} % of the samples lost, the longest {longest:.2f} s'
    first = np.argsort(-length)[:SHOWN]
    where = ', '.join(f'{length[k]:.2f} s at {time[at[k]]:.1f} s' for k in np.sort(first))
    more = ', ...' if len(at) > SHOWN else ''
    if share < MUCH:
        return Checked(words, facts)
    return Checked(words, facts, warnings(
        f'{100 * share:.1f} % of the samples are missing, in {len(at)} gaps ({where}{more}): '
        f'look for a broken beam, lost packets, or a recorder that was too slow'
    ))  # fmt: skip


GAPS = Check('gaps', _ask)

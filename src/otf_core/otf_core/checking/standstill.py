# SPDX-License-Identifier: Apache-2.0
"""Standstills: they tell the noise of this run."""

from __future__ import annotations

from otf_core.checking.checked import Check, Checked, warnings
from otf_core.checking.seen import Seen
from otf_core.noise.standstill import MIN_TOTAL, find_standstills, standstill_noise


def _ask(seen: Seen) -> Checked:
    if seen.samples is None:
        return Checked()
    runs = find_standstills(seen.samples, seen.config.standstill_speed)
    total = float((runs[:, 1] - runs[:, 0]).sum()) * seen.samples.step
    facts: dict[str, object] = {'standstills': len(runs), 'standstill_s': total}
    words = f'{len(runs)}, {total:.1f} s in all'
    noise = standstill_noise(seen.samples, runs)
    if noise is None:
        short = f'the target stood still for {total:.1f} s only' if total < MIN_TOTAL else (
            'the points of the standstills repeat without any noise'
        )  # fmt: skip
        return Checked(words, facts, warnings(
            f'{short}: the noise is taken from machine.yaml then; let the target stand for '
            f'{MIN_TOTAL:g} s at the start and the end, unfiltered'
        ))  # fmt: skip
    level = 1e6 * noise.noise.level
    facts |= {'noise_range_um': float(level[0]), 'noise_angle_urad': level[1:].tolist()}
    return Checked(
        f'{words}; noise {level[0]:.2f} um along the beam, {level[1]:.2f} and {level[2]:.2f} '
        f'urad across',
        facts,
    )


STANDSTILL = Check('standstill', _ask)

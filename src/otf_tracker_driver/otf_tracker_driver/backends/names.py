# SPDX-License-Identifier: Apache-2.0
"""The registry of backends: one line per backend, name to module and class."""

from __future__ import annotations

BACKENDS = {
    'simulated': 'otf_tracker_driver.backends.simulated:SimulatedTracker',
    'replay': 'otf_tracker_driver.backends.replay:Replay',
}

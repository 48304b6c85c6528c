# SPDX-License-Identifier: Apache-2.0
"""Noise of a tracker at rest: levels, colour, tails, events."""

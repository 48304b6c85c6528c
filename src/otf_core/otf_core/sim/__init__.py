# SPDX-License-Identifier: Apache-2.0
"""Simulated cell: truth machine, drive and tracker; the only place that draws random numbers."""

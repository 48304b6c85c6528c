# SPDX-License-Identifier: Apache-2.0
"""Calibration of machines with rotary axes: parts, matching, pieces, rows, solution, tables."""

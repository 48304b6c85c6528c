# SPDX-License-Identifier: Apache-2.0
"""Sections of the report of a calibration: a file each, and its line in ``calibration_report``.

A section is a function of ``Facts`` named ``section``; None where it has nothing to say.
"""

# SPDX-License-Identifier: Apache-2.0
"""Sections of the report of a calibration: a file for each question of its reader.

A section is a function of ``Facts`` named ``..._section``; None where it has nothing to say. Its
line in ``reports.calibration`` puts it in its place.
"""

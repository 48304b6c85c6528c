# SPDX-License-Identifier: Apache-2.0
"""Sections of the gap report: a file each, and its line in ``gap_report``.

A section is a function of a ``Diagnosis`` named ``section``.
"""

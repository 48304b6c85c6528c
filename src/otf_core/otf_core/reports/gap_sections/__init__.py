# SPDX-License-Identifier: Apache-2.0
"""Sections of the report of a diagnosis: a file for each question of its reader.

A section is a function of ``Diagnosis`` named ``..._section``; its line in
``reports.diagnosis.SECTIONS`` puts it in its place.
"""

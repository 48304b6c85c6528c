# SPDX-License-Identifier: Apache-2.0
"""Whole files or none, strict YAML and JSON, CSV of points."""

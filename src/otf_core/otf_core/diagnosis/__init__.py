# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of the gap between a real run and its simulation."""

# SPDX-License-Identifier: Apache-2.0
"""Tracker driver node."""

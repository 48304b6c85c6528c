# SPDX-License-Identifier: Apache-2.0
"""Recordings reduced to pieces of straight travel, or to standstills."""

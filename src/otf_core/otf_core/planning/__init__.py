# SPDX-License-Identifier: Apache-2.0
"""Which path to drive, and what a recording of it would show."""

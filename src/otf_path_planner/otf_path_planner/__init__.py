# SPDX-License-Identifier: Apache-2.0
"""Path planner node."""

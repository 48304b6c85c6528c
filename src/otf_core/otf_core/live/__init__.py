# SPDX-License-Identifier: Apache-2.0
"""What people see of a run under way, as plain numbers and lines: no drawing, no ROS."""

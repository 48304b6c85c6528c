# SPDX-License-Identifier: Apache-2.0
"""From the clock of a tracker to that of the host; knows no ROS and no protocol."""

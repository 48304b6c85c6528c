# SPDX-License-Identifier: Apache-2.0
"""ROS-free core of the on-the-fly machine-tool calibration; import what you need by module."""

__version__ = '0.1.0'

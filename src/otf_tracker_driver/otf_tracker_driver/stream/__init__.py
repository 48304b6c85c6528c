# SPDX-License-Identifier: Apache-2.0
"""Points as lines of text or JSON over TCP, UDP or a serial line; knows no ROS."""

# SPDX-License-Identifier: Apache-2.0
"""Leica emScon TPI over TCP: packets, commands, client; knows no ROS.

What is implemented, from which sources, and what is unsure: docs/tracker-protocol.md.
"""

# SPDX-License-Identifier: Apache-2.0
"""Inputs that contradict each other: found in seconds, said in one message, not solved."""

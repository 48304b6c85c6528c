# SPDX-License-Identifier: Apache-2.0
"""Compensator node: what to command so that the target comes where it is wanted."""

# SPDX-License-Identifier: Apache-2.0
"""Figures that are files of their own."""

# SPDX-License-Identifier: Apache-2.0
"""Figures; matplotlib is imported only when one is drawn."""

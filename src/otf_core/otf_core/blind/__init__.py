# SPDX-License-Identifier: Apache-2.0
"""Blind trial: runs whose effect is drawn and sealed, diagnosed, and scored with the key."""

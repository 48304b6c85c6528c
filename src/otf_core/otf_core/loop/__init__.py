# SPDX-License-Identifier: Apache-2.0
"""The whole circle against a real control: drive, measure, calibrate, compensate, prove it."""

# SPDX-License-Identifier: Apache-2.0
"""Live view of a calibration: markers, numbers for plots, a page for any browser."""

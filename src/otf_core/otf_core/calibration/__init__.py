# SPDX-License-Identifier: Apache-2.0
"""From recordings to error tables with uncertainties."""

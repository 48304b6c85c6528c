# SPDX-License-Identifier: Apache-2.0
"""Two sources of error tables in one convention, with normalised errors."""

# SPDX-License-Identifier: Apache-2.0
"""Where a gap lies and what shape it has."""

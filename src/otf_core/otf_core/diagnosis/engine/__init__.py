# SPDX-License-Identifier: Apache-2.0
"""Which effects the rows of a solution speak for."""

# SPDX-License-Identifier: Apache-2.0
"""Every text, table, file and figure of a result."""

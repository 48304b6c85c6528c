# SPDX-License-Identifier: Apache-2.0
"""What a machine, its tables, a path and a sample are; nothing is estimated here."""

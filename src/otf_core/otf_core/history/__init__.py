# SPDX-License-Identifier: Apache-2.0
"""Results of years: kept as plain files, compared, and judged for how long they hold."""

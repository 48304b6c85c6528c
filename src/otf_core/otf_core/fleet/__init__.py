# SPDX-License-Identifier: Apache-2.0
"""Many recordings: one process each, here or on other hosts, results as if done one by one."""

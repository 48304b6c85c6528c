# SPDX-License-Identifier: Apache-2.0
"""The effects of the catalogue: one file each."""

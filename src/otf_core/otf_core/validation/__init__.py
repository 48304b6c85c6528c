# SPDX-License-Identifier: Apache-2.0
"""The paper's comparisons on simulated cells (Sanders et al. 2023, section 2)."""

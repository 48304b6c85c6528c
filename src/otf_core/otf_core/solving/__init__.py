# SPDX-License-Identifier: Apache-2.0
"""From pieces to error functions: unknowns, weights, priors, solution."""

# SPDX-License-Identifier: Apache-2.0
"""A tracker that does not exist: an emScon server whose samples come from the simulated cell."""

# SPDX-License-Identifier: Apache-2.0
"""Where the tracker is, and which leg of the path each sample belongs to."""

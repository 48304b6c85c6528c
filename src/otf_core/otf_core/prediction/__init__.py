# SPDX-License-Identifier: Apache-2.0
"""What error tables say at points, how surely, and how far outside."""

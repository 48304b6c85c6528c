# SPDX-License-Identifier: Apache-2.0
"""What a file is and says: one kind a file."""

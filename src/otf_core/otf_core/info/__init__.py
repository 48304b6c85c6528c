# SPDX-License-Identifier: Apache-2.0
"""What a file is and says: kinds that otf writes, kinds that people bring."""

# SPDX-License-Identifier: Apache-2.0
"""rosbag2 and MCAP to samples and nominal path, and back."""

# SPDX-License-Identifier: Apache-2.0
"""What is wrong with an installation, and what to do; one check a file, numpy is not needed."""

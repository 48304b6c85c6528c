# SPDX-License-Identifier: Apache-2.0
"""Version of the package: results name it, and its description is made from it."""

__version__ = '0.1.0'

# SPDX-License-Identifier: Apache-2.0
"""Helpers shared by the nodes: quality of service, message conversion, parameters."""

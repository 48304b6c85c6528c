# SPDX-License-Identifier: Apache-2.0
"""Processes of viewer and page: what their commands start."""

from __future__ import annotations

from otf_ros import entry


def viewer() -> int:
    """Run the viewer; returns the exit code."""
    return entry.main('otf_view.viewer_node')


def page() -> int:
    """Run the page; returns the exit code."""
    return entry.main('otf_view.page_node')

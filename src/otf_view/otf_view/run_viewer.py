# SPDX-License-Identifier: Apache-2.0
"""Executable: the node viewer."""

from __future__ import annotations

from otf_ros import entry


def main() -> int:
    """Run the node; returns the exit code."""
    return entry.main('otf_view.viewer_node')


if __name__ == '__main__':
    raise SystemExit(main())

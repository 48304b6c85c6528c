# SPDX-License-Identifier: Apache-2.0
"""Executable of this package: its node."""

from __future__ import annotations

from otf_ros import entry

main = entry.node('otf_path_planner.node', 'PathPlanner')

if __name__ == '__main__':
    raise SystemExit(main())

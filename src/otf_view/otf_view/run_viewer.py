# SPDX-License-Identifier: Apache-2.0
"""Executable: the node viewer."""

from __future__ import annotations

from otf_ros import entry

main = entry.node('otf_view.viewer_node', 'Viewer')

if __name__ == '__main__':
    raise SystemExit(main())

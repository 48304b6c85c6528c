# SPDX-License-Identifier: Apache-2.0
"""Executable: the node page."""

from __future__ import annotations

from otf_ros import entry

main = entry.node('otf_view.page_node', 'Page')

if __name__ == '__main__':
    raise SystemExit(main())

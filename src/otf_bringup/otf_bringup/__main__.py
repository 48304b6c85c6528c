# SPDX-License-Identifier: Apache-2.0
"""Executable of this package: the demonstration."""

from __future__ import annotations

from otf_ros import entry

INTERRUPTED = 130
"""Exit code, as of the command line."""


def main() -> int:
    """Run the demonstration; returns the exit code."""
    return entry.main('otf_bringup.demo', INTERRUPTED)


if __name__ == '__main__':
    raise SystemExit(main())

# SPDX-License-Identifier: Apache-2.0
"""Definitions of messages as text, which bags carry for those who read them."""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_share_directory


def message_text(package: str, name: str) -> str:
    """Return the definition of a message, as installed with its package."""
    share = Path(get_package_share_directory(package))
    return (share / 'msg' / f'{name}.msg').read_text(encoding='utf-8')

# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a source of samples."""

from __future__ import annotations

from otf_core.errors import InputError


class Unreachable(InputError):
    """The source is not there, or not ready yet; the same attempt may succeed later."""

# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with a tracker; every message is one line that says what to do."""

from __future__ import annotations

from otf_core.errors import InputError
from otf_tracker_driver.emscon.codes import command_text, status_text
from otf_tracker_driver.errors import Unreachable


class TrackerError(InputError):
    """The tracker cannot be used as it is."""


class LinkError(TrackerError, Unreachable):
    """There is no connection, or it was lost; connecting again may help."""


class CommandRefused(TrackerError):
    """The tracker answered a command with an error.

    Attributes
    ----------
    status : int
        Result code.
    """

    def __init__(self, command: int, status: int) -> None:
        super().__init__(command, status)
        self.status = status

    def __str__(self) -> str:
        command, status = self.args
        return f'{command_text(command)}: {status_text(status)}'
